"""Compose tasks for tests from a few words: the size of each term, and when episodes end."""

from gctd3.envs.factory import build_env
from gctd3.envs.settings import EnvSettings, LibrarySettings
from gctd3.robots.robot import Robot
from gctd3.robots.settings import RobotSettings
from gctd3.tasks import reward_terms as terms
from gctd3.tasks.randomisations import JointNoise
from gctd3.tasks.reward import Reward, paper_terms
from gctd3.tasks.terminations import Fall, Finish, LongContact, StuckHip, TimeLimit
from gctd3.tasks.walk import WalkingTask, WalkSettings

# Terms beside the paper's, by the sizes that `reward` takes of them.
SHAPING = {
    "antiphase": lambda size: terms.Antiphase(-size),
    "single_support": lambda size: terms.SingleSupport(size),
    "overspeed": lambda size: terms.Overspeed(-size),
    "swing": lambda size: terms.SwingTime(-size),
    "tilt": lambda size: terms.Tilt(-size),
    "heading": lambda size: terms.Heading(-size),
    "off_line": lambda size: terms.OffLine(-size),
}


def reward(**changes):
    """Return the paper's reward with other terms by name: a term, the size of one of SHAPING, or None."""
    made = {k: SHAPING[k](v) if isinstance(v, float) else v for k, v in changes.items()}
    return Reward({k: v for k, v in {**paper_terms(), **made}.items() if v is not None})


def walk(
    fall_height=-0.1,
    contact_steps=40,
    hip_steps=50,
    finish=15.0,
    time_limit=1600,
    fall_tilt=0.8,
    angle_noise=0.05,
    velocity_noise=0.1,
    ends=None,
    **settings,
):
    """Return the paper's walk with other terminations, or other noise on its starts."""
    terminations = {
        "fall": Fall(fall_height, fall_tilt),
        "long_contact": LongContact(contact_steps),
        "stuck_hip": StuckHip(hip_steps),
        "finish": Finish(finish),
        "time_limit": TimeLimit(time_limit),
        **(ends or {}),
    }
    noise = {"joint_noise": JointNoise(angle_noise, velocity_noise)}
    return WalkSettings(terminations=terminations, randomisations=noise, **settings)


STILL = {"angle_noise": 0.0, "velocity_noise": 0.0}  # every episode starts alike


def walking(robot="biped", of=None, **settings):
    """Return the walking task on a robot, or on one given by name, under the reward ``of``."""
    robot = Robot.from_mjcf(robot) if isinstance(robot, str) else robot
    return WalkingTask(robot, of, walk(**settings))


def env_of(task, seed=0, backend="batched", num_envs=4, threads=1, check=False):
    """Make an environment of a few robots."""
    return build_env(task, EnvSettings(backend, num_envs, threads, check), seed)


def library_task(library, name, feet=None, forward=None, **options):
    """Make a task of another library."""
    settings = LibrarySettings(library=library, name=name, **options)
    return settings.build(RobotSettings(feet=feet, forward=forward))


def library_env(library, name, num_envs=1, seed=0, **options):
    """Make an environment of a task of another library."""
    return build_env(library_task(library, name, **options), EnvSettings("library", num_envs), seed)
