"""The material of a gel: law, constants and surface friction; a section of ``sensor.yaml``."""

import math
from typing import Annotated, Literal

from pydantic import Field, model_serializer, model_validator

from simgen.config.strict_section import StrictSection


class Material(StrictSection):
    """A nearly incompressible hyperelastic solid with Coulomb friction on its surface.

    ``law`` names a law of `simgen.fem.material`; ``c20_pa`` and ``c30_pa`` are constants of the Yeoh law.
    """

    law: Literal["neo_hookean", "yeoh"] = "neo_hookean"
    youngs_modulus_pa: Annotated[float, Field(ge=1e3, le=1e9)]
    poisson_ratio: Annotated[float, Field(ge=0.01, le=0.49999)]
    c20_pa: float = 0.0
    c30_pa: Annotated[float, Field(ge=0.0, le=1e9)] = 0.0
    friction: Annotated[float, Field(ge=0.0, le=2.0)]
    source: str = ""  # where the values come from

    @property
    def law_constants(self) -> dict[str, float]:
        """Constants of the law other than E and nu, in units of E."""
        E = self.youngs_modulus_pa
        return {"c20": self.c20_pa / E, "c30": self.c30_pa / E} if self.law == "yeoh" else {}

    @property
    def elasticity(self) -> str:
        """Law and constants as text."""
        law = f"Yeoh, C20 = {self.c20_pa:g} Pa, C30 = {self.c30_pa:g} Pa, " if self.law == "yeoh" else ""
        return f"{law}E = {self.youngs_modulus_pa:g} Pa, nu = {self.poisson_ratio:g}"

    @model_validator(mode="after")
    def _constants_suit_the_law(self):
        if self.law == "neo_hookean":
            if self.c20_pa or self.c30_pa:
                raise ValueError("c20_pa and c30_pa are constants of law: yeoh; law: neo_hookean has none")
            return self
        # Stress must rise with simple shear, dW/ds must be positive for s >= -1 (half the volume at s = -1), and the
        # volumetric part must be positive at rest (simgen/fem/material/yeoh.py).
        nu, c30 = self.poisson_ratio, self.c30_pa
        c10 = self.youngs_modulus_pa / (4.0 * (1.0 + nu))
        least = -math.sqrt(5.0 / 3.0 * c10 * c30)
        most = math.sqrt(3.0 * c10 * c30) if 3.0 * c30 > c10 else 0.5 * c10 + 1.5 * c30
        most = min(most, 0.5 * c10 * nu / (1.0 - 2.0 * nu))
        if not 0.99 * least <= self.c20_pa <= 0.99 * most:
            interval = f"{0.99 * least + 0.0:.4g} to {0.99 * most:.4g} with this E, nu and c30_pa"
            raise ValueError(f"c20_pa = {self.c20_pa:g} is not allowed; allowed: {interval}")
        return self

    @model_serializer(mode="wrap")
    def _without_constants_of_other_laws(self, handler):
        """Leave the law out for neo-Hookean gels, so that descriptions equal those in existing datasets."""
        hidden = ("law", "c20_pa", "c30_pa") if self.law == "neo_hookean" else ()
        return {key: value for key, value in handler(self).items() if key not in hidden}
