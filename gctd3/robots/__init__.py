"""Robots: read from MJCF files, with their base, joints, feet and mirror image, and as a kinematic graph."""
