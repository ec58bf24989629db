"""Settings: Hydra YAML, reachable by other projects as ``pkg://gctd3.conf``."""
