"""Configurations that Hydra reads as ``pkg://gctd3.conf``; whoever reads them so gets the defaults of settings too."""

from gctd3.config.completion import install

install()
