"""Interface of a material law: its constants, and the functions that kernels call for stress and tangent.

Every law is an energy W of the shape on top of one volumetric part, per unit of rest volume::

    psi(F) = W(F) - mu ln J + lam/2 (J - 1)^2

With lam = gamma + (lam - gamma), only the second part acts through the continuous pressure p, so that ::

    psi(F, p) = W(F) - mu ln J + gamma/2 (J - 1)^2 + p (J - 1) - p^2 / (2 (lam - gamma))

Eliminating p pointwise returns psi(F): the split changes the discretisation, not the material. It keeps the
displacement block definite in deep presses, like "grad-div" stabilisation of incompressible flow.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Self

import warp as wp

MOST_CONSTANTS = 4  # of a law, beside mu


@dataclass(frozen=True)
class Law:
    """Constants of a material in solver units; a subclass is a law and names the functions of its kernels.

    Kernels work in an element's coordinates xi. With g = dxi/dX, ``F`` is dx/dxi, ``metric`` is mu g g^T and ``cof`` is
    cof(F) det g. ``J``, ``p``, ``mu`` and ``gamma`` are numbers, and the vector ``c`` holds `kernel_constants`. The
    first two functions run in double precision, the others in single.

    first_piola(F, cof, metric, J, p, mu, gamma, c) : stress dpsi/dF, 3 x 3
    cauchy(F, J, p, mu, gamma, c) : Cauchy stress, 3 x 3, with F = dx/dX
    modulus(F, cof, metric, J, p, mu, gamma, c) : struct that describes the tangent at a point. Its field ``cofactor``
        is cof, and ``metric`` multiplies dF in dP; damping is added to ``metric``
    increment(dF, modulus, dp) : dP, the change of stress with dF and dp
    block(ga, gb, modulus) : 3 x 3 derivative of node a's force by node b's displacement, from shape gradients by xi
    own_block(g, modulus, volume) : `block` of a node with itself, times a volume
    """

    mu: float  # shear modulus at rest
    lam: float  # Lame's first parameter, without `lam_of_shape`
    gamma: float  # part of lam that acts pointwise
    pressure_compliance: float  # 1 / (lam - gamma); 0 where the element carries no pressure

    name: ClassVar[str]  # in a sensor's material
    first_piola: ClassVar[wp.Function]
    cauchy: ClassVar[wp.Function]
    modulus: ClassVar[wp.Function]
    increment: ClassVar[wp.Function]
    block: ClassVar[wp.Function]
    own_block: ClassVar[wp.Function]

    @classmethod
    def from_engineering(
        cls, youngs_modulus: float, poisson_ratio: float, split: float | None, **constants: float
    ) -> Self:
        """Take E and nu at small strains and the law's own constants.

        ``split`` is gamma/mu, or None for all of lam pointwise (no pressure). gamma is at most lam/2, so that the
        pressure keeps a finite stiffness for compressible solids too. Raises ValueError unless 0 < nu < 0.5, lam > 0.
        """
        if not 0.0 < poisson_ratio < 0.5:
            raise ValueError(f"poisson_ratio = {poisson_ratio}, allowed: above 0 and below 0.5")
        mu = youngs_modulus / (2.0 * (1.0 + poisson_ratio))
        lam = 2.0 * mu * poisson_ratio / (1.0 - 2.0 * poisson_ratio) - cls.lam_of_shape(mu, **constants)
        if lam <= 0.0:
            raise ValueError(f"{constants}: too large for poisson_ratio = {poisson_ratio}")
        if split is None:
            return cls(mu, lam, gamma=lam, pressure_compliance=0.0, **constants)
        gamma = min(split * mu, 0.5 * lam)
        return cls(mu, lam, gamma, pressure_compliance=1.0 / (lam - gamma), **constants)

    @classmethod
    def lam_of_shape(cls, mu: float, **constants: float) -> float:
        """The part of Lame's first parameter that W contributes at rest. The volumetric part has that much less."""
        return 0.0

    @property
    def kernel_constants(self) -> tuple[float, ...]:
        """The law's own constants, `MOST_CONSTANTS` at most, in the order in which its functions read them."""
        return ()


def law_module(file: str, law: type[Law], device: str = "") -> wp.Module:
    """Warp module of a file's kernels for one law. Warp compiles it when a body of this law is first used.

    device : "cpu" or "gpu" if only such devices load it, see `simgen.fem.groups`
    """
    module = wp.get_module(".".join(filter(None, (file, law.name, device))))
    wp.set_module_options({"enable_backward": False}, module)
    return module
