"""The budget of uncertainty: sources, and their shares in the variance of each parameter."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from kreisel.geometry.rotation import Array


class Source(StrEnum):
    """Where uncertainty comes from, in the order of budgets."""

    SENSOR = "sensor noise"
    PATH = "reference on the path"
    STANDSTILL = "reference at standstill"
    PRIOR = "prior and site"
    ROBOT = "robot and frames"
    CLOCKS = "clocks"
    EFFECTS = "undecided error terms"
    MISFIT = "lack of fit"


@dataclass(frozen=True)
class Budget:
    """Where the uncertainty of each parameter comes from (GUM, JCGM 100:2008, H.1).

    Attributes
    ----------
    names, deviation
        The parameters, and their standard deviations (n,), SI.
    causes
        What the variance comes from, with the source that each cause belongs to.
    shares : (n, causes)
        Of each cause in the variance; zero for parameters that are known exactly.
    """

    names: tuple[str, ...]
    deviation: Array
    causes: Mapping[str, Source]
    shares: Array

    @classmethod
    def of(cls, names: tuple[str, ...], causes: Mapping[str, Source], variance: Array) -> Budget:
        """Return the budget of parameters by what each cause adds to their variances, (n, causes), SI."""
        whole = variance.sum(axis=1, keepdims=True)
        return cls(names, np.sqrt(whole[:, 0]), causes, variance / np.where(whole > 0.0, whole, 1.0))

    @property
    def by_source(self) -> Mapping[Source, Array]:
        """Share of each source in the variance of every parameter, (n,); of the sources that matter anywhere."""
        out = {}
        for source in Source:
            own = [i for i, one in enumerate(self.causes.values()) if one is source]
            if self.shares[:, own].any():
                out[source] = self.shares[:, own].sum(axis=1)
        return out
