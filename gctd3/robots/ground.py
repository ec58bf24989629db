"""The ground that a robot stands on: which geom it is, what of the robot can touch it, and which sensors say so."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import mujoco
import numpy as np

from gctd3.robots.mjcf import bodies_below, body_name, colliding_geoms

_FOUND = 1  # bit of "found", the first number that a contact sensor can report


def _solid() -> dict[int, float]:
    """Return the kinds of geoms that can be a level ground, and how far half their size reaches above their centre."""
    return {int(mujoco.mjtGeom.mjGEOM_PLANE): 0.0, int(mujoco.mjtGeom.mjGEOM_BOX): 1.0}


def ground_height(model: mujoco.MjModel) -> float | None:
    """Find the height of the ground (m): a static level plane, or the top of a static level box; ``None`` without one.

    The ground is the highest geom that the contact sensors refer to; without such sensors the highest plane.
    """
    data = _at_reference(model)
    grounds = _sensed_geoms(model)
    planes = np.flatnonzero(model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE).tolist()
    heights = [
        _top(model, data, geom)
        for geom in (grounds or planes)
        if int(model.geom_type[geom]) in _solid() and is_static(model, geom) and _is_level(data, geom)
    ]
    return max(heights, default=None)


def find_floor(model: mujoco.MjModel, root: int) -> int | None:
    """Find the geom that the robot stands on, ``None`` without one.

    It is static, a plane, a height field or a level box that something of the robot can touch: the one that contact
    sensors name, else a plane, else a height field, else the highest box below the robot.

    Args:
        model: The model.
        root: Index of the robot's root body.
    """
    data, types = _at_reference(model), mujoco.mjtGeom
    robot = [geom for body in bodies_below(model, root) for geom in geoms_of(model, body)]
    hfield, grounds = int(types.mjGEOM_HFIELD), _sensed_geoms(model)
    below, ranked = data.xpos[root], list[tuple[int, float, int]]()
    for geom in range(model.ngeom):
        kind = int(model.geom_type[geom])
        if not is_static(model, geom) or kind not in (*_solid(), hfield) or not _is_level(data, geom):
            continue
        if kind != int(types.mjGEOM_PLANE):
            place = data.geom_xpos[geom]
            half = model.hfield_size[model.geom_dataid[geom]] if kind == hfield else model.geom_size[geom]
            beside = np.abs((below - place)[:2] @ data.geom_xmat[geom].reshape(3, 3)[:2, :2]) > half[:2]
            if beside.any() or (kind != hfield and _top(model, data, geom) > below[2]):
                continue
        if not any(can_collide(model, geom, other) for other in robot):
            continue
        order = {int(types.mjGEOM_PLANE): 0, hfield: 1}.get(kind, 2)
        ranked.append((-1 if geom in grounds else order, -_top(model, data, geom), geom))
    return min(ranked)[2] if ranked else None


def is_static(model: mujoco.MjModel, geom: int) -> bool:
    """Tell whether a geom cannot move."""
    body = int(model.geom_bodyid[geom])
    return int(model.body_weldid[body]) == 0 and int(model.body_mocapid[body]) < 0


def geoms_of(model: mujoco.MjModel, body: int) -> range:
    """Return the indices of a body's geoms."""
    start = int(model.body_geomadr[body])
    return range(start, start + int(model.body_geomnum[body]))


def can_collide(model: mujoco.MjModel, first: int, second: int) -> bool:
    """Tell whether MuJoCo looks for contacts between two geoms: by an explicit pair, else by their types of contact."""
    pairs = zip(model.pair_geom1.tolist(), model.pair_geom2.tolist(), strict=True)
    if any({first, second} == {a, b} for a, b in pairs):
        return True
    bodies = sorted((int(model.geom_bodyid[first]), int(model.geom_bodyid[second])))
    if (bodies[0] << 16) + bodies[1] in model.exclude_signature.tolist():
        return False
    types, affinities = model.geom_contype, model.geom_conaffinity
    return bool((types[first] & affinities[second]) | (types[second] & affinities[first]))


def touching_bodies(model: mujoco.MjModel, root: int, floor: int) -> list[int]:
    """Return the indices of the robot's bodies with a geom that can touch the floor."""
    return [b for b in bodies_below(model, root) if any(can_collide(model, g, floor) for g in geoms_of(model, b))]


def contact_sensors(model: mujoco.MjModel, root: int) -> dict[str, int]:
    """Return the index in ``sensordata`` of the number of ground contacts of each body of the robot that has a sensor.

    A sensor may name the body or its only geom that collides on either side, and on the other side something that
    cannot move, or nothing. Sensors that do not report ``found``, or of other bodies, are passed over.

    Args:
        model: The model.
        root: Index of the robot's root body.
    """
    robot, sensors = set(bodies_below(model, root)), dict[str, int]()
    for i in np.flatnonzero(model.sensor_type == mujoco.mjtSensor.mjSENS_CONTACT):
        if not int(model.sensor_intprm[i, 0]) & _FOUND:
            continue
        sides = [
            (int(model.sensor_objtype[i]), int(model.sensor_objid[i])),
            (int(model.sensor_reftype[i]), int(model.sensor_refid[i])),
        ]
        for own, other in (sides, sides[::-1]):
            body = _body_of(model, *own)
            if body in robot and _is_ground(model, *other):
                sensors.setdefault(body_name(model, body), int(model.sensor_adr[i]))
    return sensors


def velocity_sensors(model: mujoco.MjModel) -> dict[str, int]:
    """Return the index in ``sensordata`` of the x component of the sensed velocity of each body in the world.

    It is that of a site of the body, or else of the body itself.
    """
    sensors = dict[str, int]()
    for i in range(model.nsensor):
        moves = model.sensor_type[i] == mujoco.mjtSensor.mjSENS_FRAMELINVEL
        kind, index = int(model.sensor_objtype[i]), int(model.sensor_objid[i])
        if not moves or model.sensor_reftype[i] != mujoco.mjtObj.mjOBJ_UNKNOWN:
            continue
        if kind == mujoco.mjtObj.mjOBJ_SITE:
            sensors[body_name(model, int(model.site_bodyid[index]))] = int(model.sensor_adr[i])
        elif kind in (mujoco.mjtObj.mjOBJ_BODY, mujoco.mjtObj.mjOBJ_XBODY):
            sensors.setdefault(body_name(model, index), int(model.sensor_adr[i]))
    return sensors


def _body_of(model: mujoco.MjModel, kind: int, index: int) -> int:
    """Return the body whose contacts one side of a contact sensor counts, -1 if it is not all contacts of one body."""
    objects = mujoco.mjtObj
    if kind == objects.mjOBJ_BODY or (kind == objects.mjOBJ_XBODY and len(bodies_below(model, index)) == 1):
        return index
    if kind == objects.mjOBJ_GEOM:
        body = int(model.geom_bodyid[index])
        return body if colliding_geoms(model, body) == [index] else -1
    return -1


def _is_ground(model: mujoco.MjModel, kind: int, index: int) -> bool:
    objects = mujoco.mjtObj
    if kind == objects.mjOBJ_GEOM:
        return is_static(model, index)
    if kind in (objects.mjOBJ_BODY, objects.mjOBJ_XBODY):
        return int(model.body_weldid[index]) == 0 and (kind == objects.mjOBJ_BODY or index > 0)
    return bool(kind == objects.mjOBJ_UNKNOWN)


def _sensed_geoms(model: mujoco.MjModel) -> list[int]:
    """Return the static geoms that contact sensors name."""
    contact = model.sensor_type == mujoco.mjtSensor.mjSENS_CONTACT
    named: list[int] = []
    for kinds, ids in ((model.sensor_objtype, model.sensor_objid), (model.sensor_reftype, model.sensor_refid)):
        named += ids[contact & (kinds == mujoco.mjtObj.mjOBJ_GEOM)].tolist()
    return [geom for geom in dict.fromkeys(named) if is_static(model, geom)]


def _at_reference(model: mujoco.MjModel) -> mujoco.MjData:
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    return data


def _is_level(data: mujoco.MjData, geom: int) -> bool:
    return bool(data.geom_xmat[geom, 8] > 1.0 - 1e-9)


def _top(model: mujoco.MjModel, data: mujoco.MjData, geom: int) -> float:
    thick = _solid().get(int(model.geom_type[geom]), 0.0) * model.geom_size[geom, 2]
    return float(data.geom_xpos[geom, 2] + thick)


# Completion.


def missing_geoms(spec: mujoco.MjSpec) -> list[str]:
    """Return the names of geoms that pairs and contact sensors refer to and the file does not have."""
    known = {geom.name for geom in spec.geoms}
    named = [name for pair in spec.pairs for name in (pair.geomname1, pair.geomname2)]
    for sensor in spec.sensors:
        named += [sensor.objname] if sensor.objtype == mujoco.mjtObj.mjOBJ_GEOM else []
        named += [sensor.refname] if sensor.reftype == mujoco.mjtObj.mjOBJ_GEOM else []
    return [name for name in dict.fromkeys(named) if name not in known]


def add_floor(spec: mujoco.MjSpec, name: str = "floor", contype: int = 1, conaffinity: int = 1) -> str:
    """Add a level plane at z = 0 and return its name, which is ``name`` if that is free.

    A file without a ground is no scene, and is drawn before a black sky: it gets one, and a light if it has none.
    """
    taken = {geom.name for geom in spec.geoms}
    while name in taken:
        name += "_"
    spec.worldbody.add_geom(
        name=name,
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        size=[0.0, 0.0, 0.05],
        contype=contype,
        conaffinity=conaffinity,
        rgba=[0.76, 0.79, 0.82, 1.0],
    )
    if not any(texture.type == mujoco.mjtTexture.mjTEXTURE_SKYBOX for texture in spec.textures):
        spec.add_texture(
            name="sky_of_the_ground",
            type=mujoco.mjtTexture.mjTEXTURE_SKYBOX,
            builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
            rgb1=[0.72, 0.82, 0.92],
            rgb2=[0.95, 0.97, 1.0],
            width=64,
            height=64,
        )
    if not spec.lights:
        spec.worldbody.add_light(
            type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
            pos=[0.0, 0.0, 3.0],
            dir=[0.25, 0.35, -1.0],
            diffuse=[0.5, 0.5, 0.5],
        )
    return name


def add_contact_sensors(spec: mujoco.MjSpec, bodies: Sequence[str], floor: str) -> None:
    """Add a sensor of the number of contacts with the floor for each body."""
    for body in bodies:
        spec.add_sensor(
            type=mujoco.mjtSensor.mjSENS_CONTACT,
            objtype=mujoco.mjtObj.mjOBJ_BODY,
            objname=body,
            reftype=mujoco.mjtObj.mjOBJ_GEOM,
            refname=floor,
            intprm=[_FOUND, 0, 1],
        )


def add_velocity_sensors(spec: mujoco.MjSpec, soles: Mapping[str, np.ndarray]) -> None:
    """Add a sensor of the velocity in the world (m/s) for a point of each body, at a site of its own.

    Args:
        spec: The robot, whose bodies have names.
        soles: The point by the name of the body, in the body's frame (m).
    """
    taken = {site.name for site in spec.sites}
    for body, place in soles.items():
        name = f"{body}_sole"
        while name in taken:
            name += "_"
        spec.body(body).add_site(name=name, pos=place)
        spec.add_sensor(type=mujoco.mjtSensor.mjSENS_FRAMELINVEL, objtype=mujoco.mjtObj.mjOBJ_SITE, objname=name)
