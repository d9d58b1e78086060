"""From 19 electrodes to an image: signals through trained networks to meshes of both sensors and to what the target's
camera sees, beside the truth where it is known.
"""
