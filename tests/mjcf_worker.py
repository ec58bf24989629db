"""Read paths of MJCF files from stdin and report each outcome, in a process that MuJoCo's compiler may end."""

import sys

from gctd3.errors import GCTD3Error
from gctd3.robots.graph import KinematicGraph
from gctd3.robots.robot import Robot
from gctd3.tasks.walk import WalkingTask

for line in sys.stdin:
    try:
        robot = Robot.from_mjcf(line.rstrip("\n"))
        KinematicGraph.from_robot(robot)
        WalkingTask(robot)
        answer = "ok"
    except GCTD3Error as error:
        answer = "error " + type(error).__name__ if str(error) else "silent"
    except Exception as error:
        answer = f"defect {type(error).__name__}: {error}".replace("\n", " ")
    print(answer, flush=True)
