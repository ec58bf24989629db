"""Comparison: many runs read, put into groups, compared by statistics, and written as one page."""
