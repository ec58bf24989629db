"""Tasks of a robot, as functions over arrays; nothing here steps a simulator."""
