"""Off-policy algorithms behind one interface: networks, loss, optimisers, target updates."""
