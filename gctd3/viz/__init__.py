"""Pictures: films, plots, drawings of graphs, the browser panel."""
