"""Runs: what is done with a finished one; loading, judging, drawing, showing."""
