"""Connect policies to ROS: an exported policy and a simulator as nodes of ROS 1 or ROS 2, and bags of a walk.

The policy's node is light: it needs NumPy, onnxruntime and ROS only.
"""
