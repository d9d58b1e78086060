"""simgen: paired simulated touch for two tactile sensors, by quasi-static finite elements.

Data walks one way: ``job -> sensor, indenter -> tetrahedra, pairing -> fem -> press -> dataset -> run -> cli``.
"""

__version__ = "0.1.0"
