"""Jobs and the strict YAML that they are read from; where bundled files lie; the set-up of Warp's devices."""
