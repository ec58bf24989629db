"""The walking task and the environments that simulate it."""
