"""Cases that compare with measurements of real sensors, in the folder of ``--measured``."""
