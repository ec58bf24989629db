"""Terrain: heights by hand arithmetic and by MuJoCo's rays, starts, levels, and what counts from the ground below."""

import copy
import pickle
from dataclasses import dataclass, replace

import mujoco
import numpy as np
import pytest

from gctd3.envs.simulation import Simulation
from gctd3.errors import ConfigError, RobotError
from gctd3.robots.robot import Robot
from gctd3.robots.settings import RobotSettings
from gctd3.robots.uneven_ground import Lane, put_on
from gctd3.tasks.ground import FARTHEST, LANE, LEVELS, ORIGIN, merged_boxes
from gctd3.tasks.randomisations import JointNoise
from gctd3.tasks.terminations import Finish
from gctd3.tasks.terrain import Plan, Terrain, TerrainKind
from gctd3.tasks.terrain_edge import TerrainEdge
from gctd3.tasks.terrain_kinds import Boxes, FlatGround, Gaps, RoughGround, Slopes, Stairs, SteppingStones
from gctd3.tasks.walk import WalkSettings, paper_terminations

EVERY = {
    "rough": RoughGround(),
    "slopes": Slopes(),
    "stairs": Stairs(),
    "gaps": Gaps(),
    "stones": SteppingStones(height=0.03),
    "boxes": Boxes(share=0.3),
    "flat": FlatGround(),
}
STILL = {"joint_noise": JointNoise(0.0, 0.0)}


def small(**settings):
    return Terrain(**{"length": 6.0, "width": 2.0, "behind": 1.0, "flat": 0.5, "levels": 2, "climb": 3.0, **settings})


def task_of(terrain, robot="quadruped", **settings):
    return replace(WalkSettings(), terrain=terrain, randomisations=STILL, **settings).build(RobotSettings(robot))


def plan(rows=40, columns=4, cell=0.1, difficulty=1.0, stepped=True):
    middle = 0.5 if stepped else 0.0
    along = (np.arange(rows) + middle) * cell
    across = (np.arange(columns) + middle) * cell - columns * cell / 2
    return Plan(along, across, cell, difficulty, 1.0, np.random.default_rng(0))


def everyone(simulation):
    simulation.reset(np.ones(simulation.num_robots, dtype=bool))
    return simulation


@pytest.fixture(scope="module", params=["biped", "quadruped"])
def over_all(request):
    """Return a task over every kind: the biped's lanes lie one behind the other, the quadruped's side by side."""
    return task_of(small(kinds=EVERY), request.param)


# Kinds.


def test_slopes_rise_by_the_tangent_of_their_angle():
    """Up 1 m at 45 degrees, level for 1 m, down, level: 0, 0.5, 1, 1, 1, 0.5, 0, 0, 0 every half metre."""
    heights = Slopes(degrees=45.0, run=1.0, rest=1.0)(plan(41, stepped=False))[::5, 0]
    np.testing.assert_allclose(heights, [0.0, 0.5, 1.0, 1.0, 1.0, 0.5, 0.0, 0.0, 0.0], atol=1e-12)
    half = Slopes(degrees=45.0, run=1.0, rest=1.0)(plan(41, difficulty=0.5, stepped=False))
    assert half.max() == pytest.approx(np.tan(np.radians(22.5)))


def test_stairs_climb_a_step_each_tread():
    """Two steps of 0.1 m on treads of 0.2 m, a landing of 0.3 m: cells of 0.1 m, as written out."""
    heights = Stairs(rise=0.1, tread=0.2, steps=2, rest=0.3)(plan(14))[:, 0]
    expected = [1, 1, 2, 2, 2, 2, 2, 1, 1, 0, 0, 0, 1, 1]
    np.testing.assert_allclose(heights, 0.1 * np.array(expected))


def test_gaps_are_pits_at_the_end_of_each_period():
    """A pit of 0.2 m every 0.5 m: of five cells the last two; at half difficulty the last one."""
    for difficulty, count in ((1.0, 2), (0.5, 1)):
        heights = Gaps(width=0.2, every=0.5)(plan(10, difficulty=difficulty))
        assert (heights == heights[:, :1]).all()
        expected = ([0.0] * (5 - count) + [-1.0] * count) * 2
        np.testing.assert_array_equal(heights[:, 0], expected)


def test_stones_are_squares_with_pits_around():
    """Of stones of 2 x 2 cells and gaps of one cell, rows 2, 5, 8 are pits, and a third of the other rows' cells."""
    heights = SteppingStones(size=0.2, gap=0.1)(plan(9, 12))
    assert (heights[2::3] == -1.0).all()
    stones = heights[[0, 1, 3, 4, 6, 7]] == 0.0
    np.testing.assert_array_equal(stones.sum(axis=1), 8)


def test_rough_ground_is_linear_between_its_points():
    """Points every 0.2 m and heights every 0.1 m: every second one is the mean of its neighbours."""
    heights = RoughGround(height=0.03, spacing=0.2)(plan(21, 9, stepped=False))
    np.testing.assert_allclose(heights[1::2, ::2], (heights[:-1:2, ::2] + heights[2::2, ::2]) / 2, atol=1e-12)
    np.testing.assert_allclose(heights[:, 1::2], (heights[:, :-1:2] + heights[:, 2::2]) / 2, atol=1e-12)
    assert 0.02 < np.abs(heights).max() <= 0.03


def test_boxes_stand_on_flat_ground():
    """Heights are 0 or between half of and the whole height; the covered area is near what is asked for."""
    heights = Boxes(height=0.1, share=0.2, sizes=(0.2, 0.2))(plan(200, 40))
    tops = heights[heights > 0]
    assert (heights >= 0).all() and tops.min() >= 0.05 and tops.max() <= 0.1
    # Some overlap or reach over the border.
    assert 0.1 < (heights > 0).mean() < 0.2


def test_boxes_cover_the_cells_exactly():
    """The boxes' areas add up to that of the cells above the bottom, and each cell has its own height."""
    rng = np.random.default_rng(1)
    tops = rng.choice([-1.0, 0.0, 0.1, 0.2], size=(12, 9), p=[0.2, 0.5, 0.2, 0.1])
    boxes = merged_boxes(tops, 0.5, -1.0)
    drawn = np.full(tops.shape, -1.0)
    for begin, end, right, left, top in boxes:
        part = drawn[round(begin / 0.5) : round(end / 0.5), round(right / 0.5) : round(left / 0.5)]
        assert (part == -1.0).all()
        part[:] = top
    np.testing.assert_array_equal(drawn, tops)
    assert len(merged_boxes(np.zeros((300, 40)), 0.05, -1.0)) == 1


# Ground.


def test_heights_are_those_that_rays_meet(over_all):
    """MuJoCo's rays from above, an own implementation on the compiled geoms, over lanes, pits and around them."""
    ground, model, rng = over_all.ground, over_all.stage.model, np.random.default_rng(0)
    data = mujoco.MjData(model)
    data.qpos[:] = over_all.robot.standing_qpos
    data.qpos[over_all.robot.base.height.qpos] += 50.0  # out of the way
    mujoco.mj_forward(model, data)
    low, high = ground.bounds
    places = rng.uniform(low - 0.5, high + 0.5, (1500, 2))
    seen = np.array([5.0 - ray(model, data, place @ over_all.robot.base.frame[:2]) for place in places])
    np.testing.assert_allclose(ground.height(places), seen, atol=1e-9)
    assert len(np.unique(np.round(seen, 3))) > 50


def ray(model, data, place):
    down, found = np.array([0.0, 0.0, -1.0]), np.zeros(1, dtype=np.int32)
    return mujoco.mj_ray(model, data, np.array([*place[:2], 5.0]), down, None, 1, -1, found)


def test_a_ball_touches_where_the_height_says():
    """A heightfield's contacts are at its triangles, as rays and heights are: a small ball just below and above."""
    task = task_of(small(kinds={"rough": RoughGround(height=0.1)}, levels=1))
    ground, rng = task.ground, np.random.default_rng(0)
    rows, columns = (side // 2 + 1 for side in ground.settings.shape)
    lane = Lane(ground._corners[0], 0.1, heights=ground._heights[0, :rows, :columns])
    ball = mujoco.MjSpec.from_string(
        '<mujoco><worldbody><geom type="plane" size="0 0 1"/><body name="ball"><freejoint/>'
        '<geom size="1e-3"/><body pos="0 0 .1"><joint/><geom size="1e-3"/></body></body></worldbody></mujoco>'
    )
    model = put_on(Robot.from_mjcf(ball, feet="ball"), [lane], -1.0).model
    data = mujoco.MjData(model)
    low, high = ground.bounds
    for place in rng.uniform(low + 0.1, high - 0.1, (40, 2)):
        for away, touches in ((-2e-4, True), (4e-3, False)):
            data.qpos[:3] = *place, ground.height(place) + away
            mujoco.mj_forward(model, data)
            assert (data.ncon > 0) == touches


def test_equal_seeds_give_equal_ground_and_others_other():
    one, same, other = (small(kinds=EVERY, seed=seed) for seed in (3, 3, 4))
    for name in ("rough", "stones", "boxes"):
        np.testing.assert_array_equal(one.heights(name, 1), same.heights(name, 1))
        assert (one.heights(name, 1) != other.heights(name, 1)).any()
    # A kind more, and a level more, leave the others' random numbers alone.
    fewer = small(kinds={"boxes": EVERY["boxes"]}, seed=3)
    np.testing.assert_array_equal(one.heights("boxes", 1), fewer.heights("boxes", 1))


def test_it_is_flat_where_robots_start(over_all):
    settings = over_all.settings.terrain
    start = over_all.ground._corners + settings.start
    around = start[:, None] + np.array([[-1.0, 0.0], [0.0, 0.9], [0.4, -0.9], [0.45, 0.0]])
    # A heightfield has single precision.
    np.testing.assert_allclose(over_all.ground.height(around), 0.0, atol=1e-8)


def test_the_rest_of_the_robot_stays_to_the_bit(over_all):
    plain, stage = over_all.robot.model, over_all.stage.model
    for name in ("body_mass", "body_inertia", "jnt_range", "actuator_gainprm", "dof_damping", "qpos0", "body_ipos"):
        np.testing.assert_array_equal(getattr(plain, name), getattr(stage, name))
    own = plain.geom_bodyid > 0
    np.testing.assert_array_equal(plain.geom_size[own], stage.geom_size[stage.geom_bodyid > 0])
    assert plain.stat.extent == stage.stat.extent
    np.testing.assert_array_equal(over_all.stage.standing_qpos, over_all.robot.standing_qpos)
    assert over_all.stage.leg_length == over_all.robot.leg_length


def test_masses_that_were_changed_since_are_on_the_terrain_too():
    task = task_of(small(kinds={"flat": FlatGround()}))
    heavy = replace(task.robot, model=copy.deepcopy(task.robot.model))
    heavy.model.body_mass[:] *= 2.0
    changed = task.on(heavy).stage.model
    np.testing.assert_array_equal(changed.body_mass, 2.0 * task.stage.model.body_mass)


def test_a_task_on_terrain_goes_to_other_processes(over_all):
    again = pickle.loads(pickle.dumps(over_all))
    np.testing.assert_array_equal(again.stage.model.geom_pos, over_all.stage.model.geom_pos)


# Measuring.


def test_a_robot_that_stands_on_a_step_has_its_height_and_touches_the_ground():
    """On stairs of one step of 0.1 m, 2 m on: the same pose 0.1 m higher measures as on the plane, feet down too."""
    kinds = {"stairs": Stairs(rise=0.1, tread=0.3, steps=1, rest=3.0)}
    task = task_of(small(kinds=kinds, levels=1, length=8.0))
    model = task.stage.model
    data = mujoco.MjData(model)
    spot = task.first()
    data.qpos[:] = task.put(task.robot.standing_qpos, spot)
    data.qpos[:2] += 2.0 * task.robot.base.frame[0, :2]
    data.qpos[2] += 0.1 - 1e-3  # into the ground by a millimetre
    mujoco.mj_forward(model, data)
    now = task.measure(data.qpos, data.qvel, data.sensordata, spot)
    assert now.height == pytest.approx(-1e-3, abs=1e-9)
    assert now.position == pytest.approx(2.0)
    assert now.base[task.facts.base.index("side"), 0] == pytest.approx(0.0)
    assert now.feet_down.all() and not now.other_down and not now.shank_down


def test_ground_below_is_the_mean_under_the_feet():
    """With a step of 0.1 m under the front feet alone, the ground is half of it below, turned round too."""
    kinds = {"stairs": Stairs(rise=0.1, tread=0.3, steps=1, rest=2.0)}
    ground = task_of(small(kinds=kinds, levels=1)).ground
    edge = ground._corners[0] + ground.settings.start + [0.5, 0.0]
    for yaw in (0.0, np.pi):
        assert ground.below(edge, np.asarray(yaw)) == pytest.approx(0.05)
    assert ground.below(edge + np.array([1.5, 0.0]), np.asarray(0.3)) == pytest.approx(0.1)


def test_pits_are_no_ground_to_stand_on():
    """Over a gap the height counts from its rims, so that a robot that falls in has fallen; rays see the bottom."""
    ground = task_of(small(kinds={"gaps": Gaps(width=0.3, every=1.0)}, levels=1)).ground
    pit = ground._corners[0] + ground.settings.start + [0.5 + 0.85, 0.0]
    assert ground.height(pit) == -1.0 and ground.level(pit) == 0.0


@pytest.mark.parametrize("robot", ["biped", "quadruped"])
def test_the_finish_counts_from_each_robots_own_start(robot):
    """Robots on different lanes, moved by 3 m: position 3 for all, and a finish at 2.9 m is reached by all."""
    ends = {**paper_terminations(), "finish": Finish(2.9), "stuck_hip": None, "long_contact": None}
    task = task_of(small(kinds={"flat": FlatGround(), "rough": RoughGround()}), robot, terminations=ends)
    simulation = everyone(Simulation(task, 8, threads=1))
    assert len(np.unique(simulation.memory[LANE])) > 1
    np.testing.assert_allclose(simulation.now.position, 0.0, atol=1e-9)
    forward = task.robot.forward
    # Over the flat part beyond, which ends where the next lane begins.
    simulation.state[:, 1 + forward] += 3.0 * task.robot.base.frame[0, forward if task.robot.base.free else 0]
    outcome = simulation.step(np.zeros((8, task.facts.actions)))
    np.testing.assert_allclose(simulation.now.position, 3.0, atol=0.05)
    assert (outcome.success | outcome.terminated).all() and outcome.success.any()


def test_the_edge_truncates():
    """Ahead, behind and at the sides within 0.4 m of the edge, not in the middle."""
    ends = {**paper_terminations(), "edge": TerrainEdge(0.4)}
    task = task_of(small(kinds={"flat": FlatGround()}, levels=1, sideways=0.0), terminations=ends)
    spot = task.ground.first((6,))
    start = np.broadcast_to(task.put(task.robot.standing_qpos, task.first()), (6, task.robot.model.nq)).copy()
    moves = [(0, 0), (5.5, 0), (5.7, 0), (-0.7, 0), (2, 0.7), (2, -0.7)]
    start[:, :2] += np.array(moves) @ task.robot.base.frame[:2, :2]
    model = task.robot.model
    now = task.measure(start, np.zeros((6, model.nv)), np.zeros((6, model.nsensordata)), spot)
    _, outcome = task.advance(task.begin(now, spot=spot), now)
    np.testing.assert_array_equal(outcome.truncated, [False, False, True, True, True, True])


# Starts and levels.


def test_robots_spread_over_all_lanes_without_a_curriculum():
    task = task_of(small(kinds=EVERY, curriculum=False))
    spot = task.place(np.random.default_rng(0), (28,))
    np.testing.assert_array_equal(np.bincount(spot[LANE], minlength=14), 2)
    lanes = task.ground.lane_at(spot[ORIGIN])
    np.testing.assert_array_equal(lanes[0], spot[LANE])
    away = spot[ORIGIN] - task.ground._corners[spot[LANE]] - task.settings.terrain.start
    assert (away[:, 0] == 0).all() and np.abs(away[:, 1]).max() <= 0.5 and np.ptp(away[:, 1]) > 0.3


def test_levels_rise_after_far_episodes_and_fall_after_short_ones():
    """Kind 1, level 1 of 2: 3 m rises (no higher than the last), 2.5 m stays, 1 m falls; kind 0 keeps its level."""
    task = task_of(small(kinds={"flat": FlatGround(), "rough": RoughGround()}))
    levels = np.array([[1, 0], [1, 1], [1, 1], [1, 1], [0, 0]])
    last = {LANE: np.array([2, 3, 3, 3, 2]), FARTHEST: np.array([3.0, 3.0, 2.5, 1.0, 0.0]), LEVELS: levels}
    spot = task.place(np.random.default_rng(0), (5,), last)
    np.testing.assert_array_equal(spot[LEVELS], [[1, 1], [1, 1], [1, 1], [1, 0], [0, 0]])
    kind, level = np.divmod(spot[LANE], 2)
    np.testing.assert_array_equal(level, spot[LEVELS][np.arange(5), kind])
    # Evaluations begin anywhere, whatever was learned.
    assert task.evaluated(task.reward).settings.terrain.curriculum is False


def test_levels_outlast_episodes_and_the_farthest_distance_does_not():
    task = task_of(small(kinds={"flat": FlatGround()}, levels=3, climb=0.05, drop=0.0))
    simulation = everyone(Simulation(task, 4, threads=1))
    simulation.memory[FARTHEST][:2] = 0.06
    everyone(simulation)
    np.testing.assert_array_equal(simulation.memory[LEVELS][:, 0], [1, 1, 0, 0])
    np.testing.assert_array_equal(simulation.memory[LANE], [1, 1, 0, 0])
    np.testing.assert_array_equal(simulation.memory[FARTHEST], 0.0)


def test_a_plane_draws_what_it_always_drew():
    """Without terrain neither starts nor memory change: no random number is drawn for it."""
    task = replace(WalkSettings()).build(RobotSettings("biped"))
    assert task.stage is task.robot and task.place(np.random.default_rng(0), (3,)) == {}
    simulation, rng = everyone(Simulation(task, 3, seed=5, threads=1)), np.random.default_rng(5)
    starts = [task.start(rng)[0] for _ in range(3)]
    np.testing.assert_array_equal(simulation.qpos, starts)
    assert not [name for name in simulation.memory if name.startswith("terrain")]


# Terms from outside, and wrong settings.


@dataclass(frozen=True)
class Ditch(TerrainKind):
    """Lead through a ditch."""

    deep: float = 0.2

    def __call__(self, plan):
        """Return the heights."""
        return np.where(np.abs(plan.along - 2.0) < 0.5, -self.deep * plan.difficulty, 0.0)[:, None] + 0.0 * plan.across


def test_a_kind_of_ones_own():
    ground = task_of(small(kinds={"ditch": Ditch()})).ground
    middle = ground._corners + ground.settings.start + [0.5 + 2.0, 0.0]
    np.testing.assert_allclose(ground.height(middle), [-0.1, -0.2])


@dataclass(frozen=True)
class Wrong(TerrainKind):
    """Return one row."""

    def __call__(self, plan):
        """Return too little."""
        return np.zeros(3)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (
            {"kinds": {"stairs": Stairs(rise=0.6, steps=1)}},
            r"kinds\.stairs must have no step higher than .* legs, 0\.59 m",
        ),
        (
            {"kinds": {"rough": RoughGround(height=0.2)}, "depth": 0.1},
            r"kinds\.rough has heights down to .*depth must be more",
        ),
        ({"kinds": {"mine": Wrong()}}, r"kinds\.mine must return finite heights of shape \[71, 21\], got \[3\]"),
        ({"kinds": {"rough": None}}, "kinds must hold at least one kind"),
        ({"kinds": {"rough": 3}}, r"kinds\.rough must be null or a mapping whose _target_ is a TerrainKind, got 3"),
        ({"cell": 0.001, "memory": 10.0}, r"cell must be at least about 0\.0\d+ m .* within memory=10 MiB, got 0.001"),
        ({"cell": 2.0}, r"cell \* mesh must be at most half of width: cell at most 0\.5 m, got 2"),
        ({"levels": 0}, "levels must be at least 1"),
        ({"sideways": 1.5}, "sideways must be at most half of width"),
        ({"flat": 7.0}, "flat must be below length"),
        ({"drop": 4.0}, "drop must be at most climb"),
        ({"depth": 0.0}, "depth must be above 0"),
    ],
)
def test_wrong_settings_are_refused_in_a_line(change, said):
    with pytest.raises(ConfigError, match=said) as error:
        task_of(small(**{"kinds": {"flat": FlatGround()}, **change}))
    assert len(str(error.value).splitlines()) == 1


def test_a_compiled_model_cannot_be_put_on_terrain(over_all):
    model = Robot.from_mjcf(over_all.robot.model)
    with pytest.raises(RobotError, match="terrain is added to a robot's file or MjSpec, and not to a compiled model"):
        over_all.on(model)


@pytest.mark.parametrize(
    ("kind", "arguments", "said"),
    [
        (Gaps, {"width": 2.0, "every": 1.0}, "every must be above width"),
        (Boxes, {"sizes": (0.5, 0.2)}, r"sizes must be \[smallest, largest\]"),
        (Slopes, {"degrees": 80.0}, "degrees must be at most 60"),
        (Stairs, {"rise": 0.0}, "rise must be above 0"),
        (SteppingStones, {"gap": -1.0}, "gap must be above 0"),
        (RoughGround, {"spacing": 0.0}, "spacing must be above 0"),
    ],
)
def test_wrong_kinds_are_refused(kind, arguments, said):
    with pytest.raises(ConfigError, match=said):
        kind(**arguments)
