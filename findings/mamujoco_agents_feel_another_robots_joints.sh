#!/usr/bin/env bash
# Expected: each agent of a MaMuJoCo robot observes the joints that it drives, "local state", and with the default
#   agent_obsk=1 the next joints too.
# Instead: in CoupledHalfCheetah both agents observe the second cheetah's joints, nobody the first one's: both cheetahs
#   have the numbers -6 to -1, counted from the end. In ManySegmentAnt only the last ant feels its joints, and what it
#   takes for its neighbour's are x and height: the offset of the others has the wrong sign, so that the first of two
#   ants has the trunk's x, y, z and a part of its quaternion for joint angles, and the trunk's velocity for their
#   velocities. It drives joints that it never feels. HalfCheetah and Ant are as they should be.
# Versions: gymnasium-robotics 1.4.2, gymnasium 1.3.0, mujoco 3.3.7 (on 3.17.0 ManySegmentAnt is the same, and
#   CoupledHalfCheetah ends with an IndexError).
# Matters for: decentralised control, a policy for each limb: these are two of its three robots of several bodies, and
#   x, which Ant leaves out of its observation, tells an agent how far it has come.
# Source: gymnasium_robotics/envs/multiagent_mujoco/obsk.py (`off`, `bthigh0`); no issue found.
set -euo pipefail
dir=$(mktemp -d); trap 'rm -rf "$dir"' EXIT; cd "$dir"
"${PYTHON:-python3}" -m venv venv
venv/bin/pip install -q --disable-pip-version-check gymnasium==1.3.0 mujoco==3.3.7 numpy==2.2.6 pettingzoo==1.27.0 \
  jinja2==3.1.6 imageio==2.37.0 packaging==25.0
venv/bin/pip install -q --disable-pip-version-check --no-deps gymnasium-robotics==1.4.2
venv/bin/python - <<'PY'
import warnings
from importlib.metadata import version

import numpy as np

warnings.filterwarnings("ignore")
from gymnasium_robotics import mamujoco_v1

print(*(f"{name} {version(name)}" for name in ("gymnasium-robotics", "gymnasium", "mujoco")))


def look(robot, partition):
    """Return for each agent the joints that it drives, and what changes its observation when it is moved alone."""
    env = mamujoco_v1.parallel_env(robot, partition)
    env.reset(seed=0)
    simulation = env.single_agent_env.unwrapped
    model, qpos, qvel = simulation.model, simulation.data.qpos.copy(), simulation.data.qvel.copy()
    scalar = [joint for joint in map(model.joint, range(model.njnt)) if joint.type[0] != 0]
    places = {joint.name: joint.qposadr[0] for joint in scalar if not joint.name.startswith("root")}
    if model.jnt_type[0] == 0:
        places = {"trunk x": 0, **places}
    before, feels = env._get_obs(), {agent: [] for agent in env.possible_agents}
    for name, place in places.items():
        moved = qpos.copy()
        moved[place] += 0.1
        simulation.set_state(moved, qvel)
        after = env._get_obs()
        for agent in env.possible_agents:
            # The first observations are the joints' angles and velocities; the trunk's and the tendon's do not matter.
            if not np.array_equal(before[agent], after[agent]):
                feels[agent].append(name)
        simulation.set_state(qpos, qvel)
    drives = {}
    for agent, nodes in zip(env.possible_agents, env.agent_action_partitions):
        drives[agent] = sorted(model.joint(model.actuator_trnid[node.act_ids, 0]).name for node in nodes)
        unfelt = [name for name in drives[agent] if name not in feels[agent]]
        print(f"{robot} {partition} {agent} drives {' '.join(drives[agent])}")
        print(f"    feels {' '.join(feels[agent]) or 'no joint'}; of its own it does not feel {len(unfelt)}")
    return drives, feels


for robot, partition in (("HalfCheetah", "2x3"), ("Ant", "4x2")):
    drives, feels = look(robot, partition)
    assert all(set(drives[agent]) <= set(feels[agent]) and "trunk x" not in feels[agent] for agent in drives)
drives, feels = look("CoupledHalfCheetah", "1p1")
assert set(feels["agent_0"]) == set(feels["agent_1"]) == set(drives["agent_1"])
drives, feels = look("ManySegmentAnt", "2x1")
assert feels["agent_0"] == ["trunk x"] and set(feels["agent_1"]) == {"trunk x", *drives["agent_1"]}
PY
