"""Robots for tests that the library does not ship."""

from gctd3.robot import Robot


def opposite_axes(biped, folder):
    """The biped with the axes of its left joints turned round: equal motions of both legs have opposite angles."""
    text = biped.path.read_text()
    for joint, limits in (("hip", "-0.7854 0.7854"), ("knee", "-0.0012 1.3962"), ("ankle", "-0.7854 0.7854")):
        for tag, new in (("joint", f'axis="0 1 0" range="{limits}"'), ("position", f'ctrlrange="{limits}"')):
            old = f'<{tag} name="{joint}_left" class="{joint}"'
            assert text.count(old) == 1
            text = text.replace(old, f"{old} {new}")
    path = folder / "opposite.xml"
    path.write_text(text)
    return Robot.from_mjcf(path)
