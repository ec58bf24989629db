"""Comparison: many runs read, put into groups, judged by statistics, and written as one page."""
