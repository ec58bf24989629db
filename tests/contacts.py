"""Draw the contact of a foot with the ground."""

import numpy as np


def signal(text):
    """Convert a text to a contact signal: ``#`` is down, ``.`` is up."""
    return np.array([mark == "#" for mark in text.replace(" ", "")])


def square(period, steps, duty=0.6, shift=0):
    """Make a contact signal that is down for ``duty`` of every ``period`` samples."""
    return (np.arange(steps) + shift) % period < duty * period
