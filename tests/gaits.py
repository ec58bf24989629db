"""Make up measurements of a biped, by hand and at random, and walks of them."""

import numpy as np

from gctd3.tasks.measurement import Measurement

RIGHT, LEFT = 0, 1


def sense(y=0.0, z=0.0, v=0.0, hips=(0.1, -0.1), feet=(True, False), other=False):
    """Make one biped's measurement; joints in the MJCF's order: right hip, knee, ankle, then the left ones."""
    return Measurement(
        position=np.array(y),
        height=np.array(z),
        velocity=np.array(v),
        angles=np.array([hips[RIGHT], 0.0, 0.0, hips[LEFT], 0.0, 0.0]),
        velocities=np.zeros(6),
        feet_down=np.array(feet),
        other_down=np.array(other),
        shank_down=np.array(False),
        base=np.zeros((0, 2)),
        tilt=np.array(0.0),
        feet_velocity=np.zeros((0, 3)),
    )


def walk(task, *measurements):
    """Begin with the first measurement, advance by the others, and return the last memory and all outcomes."""
    memory, outcomes = task.begin(measurements[0]), []
    for now in measurements[1:]:
        memory, outcome = task.advance(memory, now)
        outcomes.append(outcome)
    return memory, outcomes


def values(outcome):
    return [float(term) for term in outcome.terms.values()]


def random_walk(rng, steps, shape):
    """Draw measurements that cross every threshold of the reward now and then."""
    return [
        Measurement(
            position=rng.uniform(0.0, 15.2, shape),
            height=rng.uniform(-0.11, 0.1, shape),
            velocity=rng.uniform(-1.0, 2.0, shape),
            angles=rng.uniform(-1.0, 1.0, (*shape, 6)),
            velocities=rng.uniform(-7.0, 7.0, (*shape, 6)),
            feet_down=rng.uniform(size=(*shape, 2)) < 0.5,
            other_down=rng.uniform(size=shape) < 0.05,
            shank_down=np.zeros(shape, dtype=bool),
            base=np.zeros((*shape, 0, 2)),
            tilt=np.zeros(shape),
            feet_velocity=np.zeros((*shape, 0, 3)),
        )
        for _ in range(steps)
    ]
