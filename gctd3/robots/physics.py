"""Hash of a compiled model's physics: equal for equal robots, however their MJCF spells them.

What is hashed, in this order: the parts of :data:`PARTS`, each field after the other, as the compiled model holds them.
Visual geoms, materials, cameras, lights, sensors, keys and comments play no part; names only of joints and actuators,
by which a policy reads and commands. MuJoCo's derived constants play none either. Numbers are rounded to nine digits of
the largest in their row, so that degrees, defaults and rotations may be written in any way.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import mujoco
import numpy as np

from gctd3.robots.mjcf import joint_name
from gctd3.robots.rounding import CUT, matrices, positive, rounded, turns

_TYPES = mujoco.mjtGeom
_ROUND = (int(_TYPES.mjGEOM_SPHERE), int(_TYPES.mjGEOM_CAPSULE), int(_TYPES.mjGEOM_CYLINDER), int(_TYPES.mjGEOM_PLANE))
_MESHES = (int(_TYPES.mjGEOM_MESH), int(_TYPES.mjGEOM_SDF))
Field = tuple[str, Any]


def physics_hash(model: mujoco.MjModel) -> str:
    """Compute the SHA-256 of a compiled model's physics."""
    return combined(part_hashes(model))


def combined(parts: dict[str, str]) -> str:
    """Return the hash of a model whose parts have these hashes."""
    return hashlib.sha256("\n".join(f"{name} {parts[name]}" for name in PARTS).encode()).hexdigest()


def part_hashes(model: mujoco.MjModel) -> dict[str, str]:
    """Compute the SHA-256 of each part of :data:`PARTS`, by its name."""
    return {name: _digest(fields(model)) for name, fields in PARTS.items()}


def solid_geoms(model: mujoco.MjModel) -> np.ndarray:
    """Return the indices of the geoms that can touch others, or that a fluid acts on."""
    able = (model.geom_contype != 0) | (model.geom_conaffinity != 0) | (model.geom_fluid[:, 0] > 0)
    able[[*model.pair_geom1, *model.pair_geom2]] = True
    return np.flatnonzero(able)


def _digest(fields: Iterator[Field]) -> str:
    digest = hashlib.sha256()
    for name, values in fields:
        digest.update(f"{name}\n".encode())
        if isinstance(values, (bytes, str)):
            digest.update(values if isinstance(values, bytes) else values.encode())
            continue
        array = np.asarray(values)
        digest.update(str(array.shape).encode())
        if array.dtype.kind == "f":
            exponents, whole = rounded(array)
            digest.update(exponents.astype("<i8").tobytes() + whole.astype("<i8").tobytes())
        else:
            digest.update(array.astype("<i8").tobytes())
    return digest.hexdigest()


# Parts of the model.


def _options(model: mujoco.MjModel) -> Iterator[Field]:
    option = model.opt
    for name in ("integrator", "cone", "solver", "iterations", "ls_iterations", "noslip_iterations", "ccd_iterations"):
        yield name, int(getattr(option, name))
    for name in ("disableflags", "enableflags", "disableactuator", "sdf_iterations", "sdf_initpoints"):
        yield name, int(getattr(option, name))
    for name in ("timestep", "tolerance", "ls_tolerance", "noslip_tolerance", "ccd_tolerance", "impratio"):
        yield name, float(getattr(option, name))
    for name in ("density", "viscosity"):
        yield name, float(getattr(option, name))
    yield "gravity", np.array(option.gravity)[None]
    yield "wind", np.array(option.wind)[None]
    # MjOption writes these only where the flag is set.
    if int(option.enableflags) & int(mujoco.mjtEnableBit.mjENBL_OVERRIDE):
        for name in ("o_margin", "o_solref", "o_solimp", "o_friction"):
            yield name, np.atleast_1d(np.array(getattr(option, name), dtype=np.float64))[None]


def _bodies(model: mujoco.MjModel) -> Iterator[Field]:
    yield "parent", model.body_parentid
    yield "place", model.body_pos
    yield "turn", turns(model.body_quat)
    yield "mocap", model.body_mocapid >= 0


def _masses(model: mujoco.MjModel) -> Iterator[Field]:
    yield "mass", model.body_mass
    yield "centre", model.body_ipos
    # The tensor in the body's frame: principal axes are not unique.
    axes = matrices(model.body_iquat)
    tensors = np.einsum("bij,bj,bkj->bik", axes, model.body_inertia, axes)
    yield "inertia", tensors[:, [0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
    yield "gravity_compensation", model.body_gravcomp


def _joints(model: mujoco.MjModel) -> Iterator[Field]:
    yield "names", "\n".join(joint_name(model, j) for j in range(model.njnt))
    yield "kind", model.jnt_type
    yield "body", model.jnt_bodyid
    turning = model.jnt_type != int(mujoco.mjtJoint.mjJNT_FREE)
    yield "anchor", model.jnt_pos * turning[:, None]
    along = np.isin(model.jnt_type, [int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)])
    yield "axis", model.jnt_axis * along[:, None]
    yield "reference", model.qpos0
    yield "gravity_compensation", model.jnt_actgravcomp


def _joint_ranges(model: mujoco.MjModel) -> Iterator[Field]:
    yield from _bounded(model, "jnt", "limited", "range")
    yield from _bounded(model, "jnt", "actfrclimited", "actfrcrange")
    limited = np.asarray(model.jnt_limited, dtype=bool)[:, None]
    for name in ("solref", "solimp"):
        yield name, getattr(model, f"jnt_{name}") * limited
    yield "margin", model.jnt_margin * limited[:, 0]


def _joint_dynamics(model: mujoco.MjModel) -> Iterator[Field]:
    yield from _fields(model, "jnt", ("stiffness", "stiffnesspoly"))
    yield "rest", model.qpos_spring * _sprung(model)
    yield from _fields(model, "dof", ("damping", "dampingpoly", "armature", "frictionloss"))
    rubbing = (model.dof_frictionloss > 0)[:, None]
    for name in ("solref", "solimp"):
        yield name, getattr(model, f"dof_{name}") * rubbing


def _geoms(model: mujoco.MjModel) -> Iterator[Field]:
    solid = solid_geoms(model)
    kinds = model.geom_type[solid]
    yield "kind", kinds
    yield "body", model.geom_bodyid[solid]
    yield "place", model.geom_pos[solid]
    whole = turns(model.geom_quat[solid])
    # Of bodies of revolution only the axis counts, in either direction unless it is a plane's normal.
    axes = matrices(model.geom_quat[solid])[:, :, 2]
    axes = np.where((kinds == int(_TYPES.mjGEOM_PLANE))[:, None], axes, positive(axes))
    axes = np.concatenate([axes, np.zeros((len(solid), 1))], axis=1)
    spheres = (kinds == int(_TYPES.mjGEOM_SPHERE))[:, None]
    yield "turn", np.where(spheres, 0.0, np.where(np.isin(kinds, _ROUND)[:, None], axes, whole))
    used = np.array([[1, 1, 1]] * len(solid), dtype=np.float64).reshape(-1, 3)
    for kind, count in ((_TYPES.mjGEOM_SPHERE, 1), (_TYPES.mjGEOM_CAPSULE, 2), (_TYPES.mjGEOM_CYLINDER, 2)):
        used[kinds == int(kind), count:] = 0
    used[np.isin(kinds, [*_MESHES, int(_TYPES.mjGEOM_HFIELD)])] = 0
    used[kinds == int(_TYPES.mjGEOM_PLANE), 2] = 0  # the spacing of its grid
    yield "size", model.geom_size[solid] * used
    for geom in solid:
        yield "form", _form(model, int(geom))
    yield "fluid", model.geom_fluid[solid]


def _contacts(model: mujoco.MjModel) -> Iterator[Field]:
    solid = solid_geoms(model)
    for name in ("contype", "conaffinity", "condim", "priority"):
        yield name, getattr(model, f"geom_{name}")[solid]
    for name in ("friction", "solref", "solimp", "solmix", "margin", "gap", "surfacevel", "adhesion"):
        if hasattr(model, f"geom_{name}"):
            yield name, getattr(model, f"geom_{name}")[solid]


def _pairs(model: mujoco.MjModel) -> Iterator[Field]:
    place = {int(geom): i for i, geom in enumerate(solid_geoms(model))}
    yield "geoms", [[place[int(a)], place[int(b)]] for a, b in zip(model.pair_geom1, model.pair_geom2, strict=True)]
    yield "dim", model.pair_dim
    names = ("friction", "solref", "solreffriction", "solimp", "margin", "gap", "adhesion")
    yield from _fields(model, "pair", names)
    yield "excluded", np.sort(model.exclude_signature)


def _equalities(model: mujoco.MjModel) -> Iterator[Field]:
    yield "kind", model.eq_type
    kinds = model.eq_objtype
    for side in ("obj1id", "obj2id"):
        objects = getattr(model, f"eq_{side}")
        yield from _referred(model, side, list(zip(kinds.tolist(), objects.tolist(), strict=True)))
    yield "active", model.eq_active0
    yield from _fields(model, "eq", ("data", "solref", "solimp"))


def _tendons(model: mujoco.MjModel) -> Iterator[Field]:
    if not model.ntendon:
        return
    yield "length", model.tendon_num
    yield "wrap", model.wrap_type
    kinds = mujoco.mjtWrap
    of = {
        int(kinds.mjWRAP_SITE): int(mujoco.mjtObj.mjOBJ_SITE),
        int(kinds.mjWRAP_JOINT): int(mujoco.mjtObj.mjOBJ_JOINT),
        int(kinds.mjWRAP_SPHERE): int(mujoco.mjtObj.mjOBJ_GEOM),
        int(kinds.mjWRAP_CYLINDER): int(mujoco.mjtObj.mjOBJ_GEOM),
    }
    wraps = zip(model.wrap_type.tolist(), model.wrap_objid.tolist(), strict=True)
    yield from _referred(model, "of", [(of.get(kind, 0), number) for kind, number in wraps])
    jointed = model.wrap_type == int(kinds.mjWRAP_JOINT)
    pulleys = model.wrap_type == int(kinds.mjWRAP_PULLEY)
    yield "factor", model.wrap_prm * (jointed | pulleys)
    yield from _bounded(model, "tendon", "limited", "range")
    yield from _bounded(model, "tendon", "actfrclimited", "actfrcrange")
    names = ("stiffness", "stiffnesspoly", "damping", "dampingpoly", "armature", "frictionloss", "lengthspring")
    yield from _fields(model, "tendon", (*names, "margin", "solref_lim", "solimp_lim", "solref_fri", "solimp_fri"))


def _actuators(model: mujoco.MjModel) -> Iterator[Field]:
    yield "names", "\n".join(model.actuator(i).name for i in range(model.nu))
    yield "transmission", model.actuator_trntype
    kinds = mujoco.mjtTrn
    of = {
        int(kinds.mjTRN_JOINT): mujoco.mjtObj.mjOBJ_JOINT,
        int(kinds.mjTRN_JOINTINPARENT): mujoco.mjtObj.mjOBJ_JOINT,
        int(kinds.mjTRN_SLIDERCRANK): mujoco.mjtObj.mjOBJ_SITE,
        int(kinds.mjTRN_SITE): mujoco.mjtObj.mjOBJ_SITE,
        int(kinds.mjTRN_TENDON): mujoco.mjtObj.mjOBJ_TENDON,
        int(kinds.mjTRN_BODY): mujoco.mjtObj.mjOBJ_BODY,
    }
    for side in (0, 1):
        numbers = model.actuator_trnid[:, side].tolist()
        chosen = [int(of.get(int(kind), 0)) for kind in model.actuator_trntype]
        yield from _referred(model, "of", list(zip(chosen, numbers, strict=True)))
    yield from _fields(model, "actuator", ("gear", "cranklength"))


def _gains(model: mujoco.MjModel) -> Iterator[Field]:
    names = ("dyntype", "gaintype", "biastype", "dynprm", "gainprm", "biasprm", "actearly", "actnum")
    yield from _fields(model, "actuator", (*names, "damping", "dampingpoly", "armature", "delay"))


def _actuator_ranges(model: mujoco.MjModel) -> Iterator[Field]:
    for name in ("ctrl", "force", "act"):
        yield from _bounded(model, "actuator", f"{name}limited", f"{name}range")


def _flexes(model: mujoco.MjModel) -> Iterator[Field]:
    if not model.nflex:
        return
    drawn = ("matid", "group", "rgba", "texcoord", "texcoordadr", "flatskin", "bvhadr", "bvhnum", "bvh_aabb")
    for name in sorted(name for name in dir(model) if name.startswith("flex_")):
        if not name.endswith(drawn):
            yield name, getattr(model, name)


PARTS: dict[str, Callable[[mujoco.MjModel], Iterator[Field]]] = {
    "options of the simulation": _options,
    "bodies": _bodies,
    "masses": _masses,
    "joints": _joints,
    "joint ranges": _joint_ranges,
    "joint damping and friction": _joint_dynamics,
    "collision geometry": _geoms,
    "contact parameters": _contacts,
    "contact pairs": _pairs,
    "equalities": _equalities,
    "tendons": _tendons,
    "actuators": _actuators,
    "actuator gains": _gains,
    "actuator ranges": _actuator_ranges,
    "flexible parts": _flexes,
}


# Fields.


def _fields(model: mujoco.MjModel, kind: str, names: Sequence[str]) -> Iterator[Field]:
    """Yield the fields that this MuJoCo has; a field that is 0 everywhere is as good as none."""
    for name in names:
        values = getattr(model, f"{kind}_{name}", None)
        if values is not None and np.any(values):
            yield name, values


def _bounded(model: mujoco.MjModel, kind: str, flag: str, name: str) -> Iterator[Field]:
    limited = np.asarray(getattr(model, f"{kind}_{flag}"), dtype=bool)
    yield flag, limited
    yield name, np.asarray(getattr(model, f"{kind}_{name}")) * limited[:, None]


def _referred(model: mujoco.MjModel, name: str, objects: Sequence[tuple[int, int]]) -> Iterator[Field]:
    """Yield the objects that others refer to: sites and geoms by their place, the rest by their index."""
    for kind, number in objects:
        yield name, [kind, number if kind not in _PLACED else -1]
        if number >= 0 and kind in _PLACED:
            of = _PLACED[kind]
            body, place, turn = (getattr(model, f"{of}_{what}")[number] for what in ("bodyid", "pos", "quat"))
            yield "body", int(body)
            yield "place", place[None]
            yield "turn", turns(turn[None])
            if of == "geom":
                yield "size", model.geom_size[number][None]


_PLACED = {int(mujoco.mjtObj.mjOBJ_SITE): "site", int(mujoco.mjtObj.mjOBJ_GEOM): "geom"}


def _sprung(model: mujoco.MjModel) -> np.ndarray:
    """Return which coordinates of ``qpos`` a spring acts on. Shape ``[nq]``."""
    sprung = np.zeros(model.nq)
    starts = [*model.jnt_qposadr.tolist(), model.nq]
    polynomial = getattr(model, "jnt_stiffnesspoly", np.zeros((model.njnt, 1)))
    for j in range(model.njnt):
        sprung[starts[j] : starts[j + 1]] = bool(model.jnt_stiffness[j]) or bool(np.any(polynomial[j]))
    return sprung


def _form(model: mujoco.MjModel, geom: int) -> bytes:
    """Return the form of a mesh or a heightfield in its own frame."""
    kind, number = int(model.geom_type[geom]), int(model.geom_dataid[geom])
    if number < 0:
        return b""
    if kind in _MESHES:
        start, count = int(model.mesh_vertadr[number]), int(model.mesh_vertnum[number])
        first, faces = int(model.mesh_faceadr[number]), int(model.mesh_facenum[number])
        points = model.mesh_vert[start : start + count].astype("<f4")
        # Single precision: a scale that is spelled in another way moves its last digit.
        scale = 10.0 ** (math.floor(math.log10(max(float(np.abs(points).max(initial=0.0)), 1e-30))) - 4)
        whole = np.floor(points.astype(np.float64) / scale + CUT).astype("<i8")
        return whole.tobytes() + model.mesh_face[first : first + faces].astype("<i8").tobytes()
    if kind == int(_TYPES.mjGEOM_HFIELD):
        start = int(model.hfield_adr[number])
        rows, columns = int(model.hfield_nrow[number]), int(model.hfield_ncol[number])
        heights = np.floor(model.hfield_data[start : start + rows * columns].astype(np.float64) * 1e6 + CUT)
        exponents, whole = rounded(model.hfield_size[number][None])
        shape = np.array([rows, columns], dtype="<i8")
        return b"".join(a.astype("<i8").tobytes() for a in (shape, exponents, whole, heights))
    return b""
