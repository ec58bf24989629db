"""The trial of a completed robot: whether its servos hold the standing pose, and what then rests on the ground."""

from __future__ import annotations

from collections.abc import Sequence

from gctd3.robots.carried_load import carrying_command
from gctd3.robots.draft import Draft, listed
from gctd3.robots.ground import contact_sensors
from gctd3.robots.held_pose import holds
from gctd3.robots.mjcf import base_joints, driven_joints, joint_name, standing_pose

FALLS = "Servos that hold the standing pose do not keep the robot from falling:"


def try_standing(draft: Draft, feet: Sequence[str], floor: int) -> None:
    """Hold the standing pose for a while; note a fall, servos that are too weak, and shanks on the ground."""
    model, root = draft.model, draft.root
    if model.nu != len(driven_joints(model)) or not len(base_joints(model, root)):
        return
    sensors = {n: a for n, a in contact_sensors(model, root).items() if n not in feet}
    held = holds(model, standing_pose(model), root, list(sensors.values()))
    if held.fell is not None:
        draft.notes.append(f"{FALLS} {held.fell:.2g} s.")
    elif held.weak:
        names = [joint_name(model, j) for j in held.weak]
        draft.notes.append(f"The servos of {listed(names)} need all of their torque to hold the standing pose.")
    resting = [name for name, address in sensors.items() if address in held.touching]
    added = {s.objname: s for s in draft.spec.sensors if s.name == "" and s.objname in draft.sensed}
    gone = [name for name in resting if name in added]
    if held.fell is not None:
        return
    if gone:
        # Soft servos sag; an action of 0 will ask them for what carries the weight.
        ids = [draft.body_id(name) for name in feet]
        command = carrying_command(model, standing_pose(model), ids, floor)
        held = holds(model, standing_pose(model), root, [sensors[name] for name in gone], command=command)
        gone = [name for name in gone if held.fell is not None or sensors[name] in held.touching]
    if gone:
        for name in gone:
            draft.spec.delete(added[name])
        draft.compile()
        draft.notes.append(f"The standing robot rests on {listed(gone)}, too, so that this does not count as a fall.")
