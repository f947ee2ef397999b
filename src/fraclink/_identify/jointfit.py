"""The result of a joint fit, and the test of what was taken as common."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fraclink._arm.link import LinkModel

__all__ = ["JointFit", "LikelihoodRatio"]


@dataclass(frozen=True)
class LikelihoodRatio:
    """Test of the common parameters against own ones for every payload.

    `statistic` = Σ (n/k) ln(MSE joint / MSE alone), k the inflation by the residual's colour; it follows
    a χ² distribution of `degrees` degrees of freedom where the parameters are common, and `p_value` is
    the chance of a larger one.
    """

    statistic: float
    degrees: int
    p_value: float

    @property
    def common(self) -> bool:
        """Whether the logs let the parameters be common (p ≥ 0.05)."""
        return self.p_value >= 0.05


@dataclass(frozen=True, eq=False)
class JointFit:
    """One structure fitted to several payloads at once.

    Arguments:
        structure: the structure; common: names of the parameters that all payloads share.
        models, gains, offsets, delays: one for each log, in their order.
        mse, aic: for each log; alone_mse: of the fits of each log for itself.
        standard_errors: of the common parameters (and of "natural_frequency 1" … for the own ones).
        stiffness: c [N·m/rad] where ω₀ was tied by eq. (5) and the length was given, else None;
            stiffness_over_square: c/L² [N/m·rad] where it was tied.
        test: whether the parameters may be common. verdict: the same in words.
        predicted: one array for each log [unit of its output].
    """

    structure: str
    common: tuple[str, ...]
    models: tuple[LinkModel, ...]
    gains: tuple[float, ...]
    offsets: tuple[float, ...]
    delays: tuple[float, ...]
    mse: tuple[float, ...]
    aic: tuple[float, ...]
    alone_mse: tuple[float, ...]
    standard_errors: dict[str, float]
    stiffness: float | None
    stiffness_over_square: float | None
    test: LikelihoodRatio
    verdict: str
    predicted: tuple[NDArray[np.float64], ...]
