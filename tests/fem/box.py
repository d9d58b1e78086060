"""The box that the tests of the solver press, hold and bend."""

from simgen.validate.meshes import box, top

__all__ = ["box", "top"]
