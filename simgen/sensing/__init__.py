"""What a sensor would output: electrode signals and camera images."""
