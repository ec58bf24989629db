"""Data: collectors and their workers, exploration, replay."""
