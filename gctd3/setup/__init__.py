"""Setup: a robot, its graph, its task and the shape of its networks, built once and handed on."""
