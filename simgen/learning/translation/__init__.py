"""Translation of electrode signals, through trained networks, to meshes of both sensors and images of the target."""
