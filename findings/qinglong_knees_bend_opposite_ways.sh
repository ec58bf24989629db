#!/usr/bin/env bash
# Expected: a humanoid's two knees bend the same way.
# Instead: in the Qinglong of fourier-robot-descriptions the axes of hip pitch, knee and ankle pitch point to the left
#   in one leg and to the right in the other, with the same limits. The right knee bends backwards by 135 degrees and
#   forwards by 5, the left one forwards by 135 and backwards by 5. The left thigh swings forwards by 105 degrees and
#   backwards by 45, the right one the other way round. With its feet under its hips the robot can crouch only with the
#   right knee in front and the left one behind. Both legs of the package's GR1, GR2 and GR3 are alike.
# Versions: fourier-robot-descriptions 0.2.7, pin 4.1.0.
# Matters for: training and inverse kinematics with this file, mirrored experience and symmetric policies.
# Source: none found.
set -euo pipefail
dir=$(mktemp -d); trap 'rm -rf "$dir"' EXIT; cd "$dir"
"${PYTHON:-python3}" -m venv venv
venv/bin/pip install -q --disable-pip-version-check pin==4.1.0 numpy==2.2.6
venv/bin/pip install -q --disable-pip-version-check --no-deps --target robots fourier-robot-descriptions==0.2.7
venv/bin/python - <<'PY'
from importlib.metadata import version
from pathlib import Path

import numpy as np
import pinocchio

URDF = Path("robots") / "fourier_robot_descriptions" / "assets" / "urdf"
NAMES = {
    "qinglong": ("J_hip_{}_pitch", "J_knee_{}_pitch", "J_ankel_{}_pitch", ("l", "r")),
    "gr1t1": ("{}_hip_pitch_joint", "{}_knee_pitch_joint", "{}_ankle_pitch_joint", ("left", "right")),
    "gr2t2": ("{}_hip_pitch_joint", "{}_knee_pitch_joint", "{}_ankle_pitch_joint", ("left", "right")),
    "gr3": ("{}_hip_pitch_joint", "{}_knee_pitch_joint", "{}_ankle_pitch_joint", ("left", "right")),
}


class Leg:
    def __init__(self, robot, side):
        self.model = pinocchio.buildModelFromUrdf(str(URDF / f"{robot}.urdf"))
        self.data = self.model.createData()
        self.hip, self.knee, self.ankle = (self.model.getJointId(name.format(side)) for name in NAMES[robot][:3])

    def at(self, joint):
        return self.model.joints[joint].idx_q

    def limits(self, joint):
        return self.model.lowerPositionLimit[self.at(joint)], self.model.upperPositionLimit[self.at(joint)]

    def place(self, hip, knee):
        """Return knee and ankle (x forwards and z upwards, in m) as seen from the hip."""
        angles = pinocchio.neutral(self.model)
        angles[self.at(self.hip)], angles[self.at(self.knee)] = hip, knee
        pinocchio.forwardKinematics(self.model, self.data, angles)
        places = [self.data.oMi[joint].translation for joint in (self.hip, self.knee, self.ankle)]
        return [(place - places[0])[[0, 2]] for place in places[1:]]

    def way(self, joint):
        """Return the range in degrees of the knee, or of the hip, as it swings what is below it forwards."""
        step = 0.01
        moved = self.place(step, 0) if joint == self.hip else self.place(0, step)
        sign = np.sign(moved[1][0] - self.place(0, 0)[1][0])
        return sorted(round(float(np.rad2deg(sign * limit))) for limit in self.limits(joint))

    def crouch(self, drop=0.1):
        """Return how far the knee is in front (m) in all poses with the ankle under the hip and drop nearer to it."""
        stretched = self.place(0, 0)[1]
        found = []
        for hip in np.linspace(*self.limits(self.hip), 90):
            for knee in np.linspace(*self.limits(self.knee), 90):
                middle, foot = self.place(hip, knee)
                if np.abs(foot - stretched - [0, drop]).max() < 0.02:
                    found.append(middle[0])
        return np.array(found)


(files,) = Path("robots").glob("fourier_robot_descriptions-*.dist-info")
print(files.stem.replace("-", " "), "pin", version("pin"), "- degrees, forwards positive")
for robot in NAMES:
    hips, knees, fronts = [], [], []
    for side in NAMES[robot][3]:
        leg = Leg(robot, side)
        hips.append(leg.way(leg.hip))
        knees.append(leg.way(leg.knee))
        fronts.append(leg.crouch())
    middles = [f"{front.mean():+.2f}" for front in fronts]
    print(f"{robot}: hips {hips}, knees {knees}; in a crouch the knees are {middles} m in front of the hips")
    assert all(len(set(np.sign(front))) == 1 for front in fronts)  # each knee can bend to one side alone
    if robot == "qinglong":
        assert hips == [[-45, 105], [-105, 45]] and knees == [[-5, 135], [-135, 5]]
        assert fronts[0].max() < -0.1 and fronts[1].min() > 0.1
    else:
        assert hips[0] == hips[1] and knees[0] == knees[1] and min(fronts[0].min(), fronts[1].min()) > 0.1
PY
