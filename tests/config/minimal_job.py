"""The least that a job has to say."""

MINIMAL = """\
name: tiny
sensors:
  digit: {model: digit, material: solid}
indenters: [sphere_7mm]
trajectories: {count: 2}
depths_mm: {first: 0.1, last: 0.3, count: 3}
"""
