"""What ``gctd3.report`` is made of: runs that belong together, statistics, figures, tables, words, a page."""
