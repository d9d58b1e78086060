"""Images of a deformed gel, as the sensor's camera sees it: height map, smoothing (`blur`), `shading`, `shadows`."""
