"""Configuration: from YAML and a command line to typed settings."""
