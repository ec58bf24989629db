"""Robots: one folder each, with an MJCF and a README of its provenance and units."""
