"""Finished runs: loading, evaluating, rendering and viewing them."""
