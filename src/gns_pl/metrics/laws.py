"""Published runout laws of columns that collapse in a plane channel."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Law:
    """A runout law (L − L0)/L0 of the aspect ratio: `low` a below a split, `high` a^`power` above.

    Between the two ranges that a source gives, its lower one is carried on to where the two meet.

    Attributes:
        source: who, and when.
        low: factor of low columns.
        high: factor of high columns.
        power: of high columns.
    """

    source: str
    low: float
    high: float
    power: float

    def __call__(self, aspect_ratio: float) -> float:
        """Return the runout in L0."""
        split = (self.high / self.low) ** (1 / (1 - self.power))
        return self.low * aspect_ratio if aspect_ratio < split else self.high * aspect_ratio**self.power


LAWS = (
    Law("Lube et al. 2005, channel", 1.2, 1.9, 2 / 3),
    Law("Lajeunesse et al. 2005, channel", 1.8, 2.3, 2 / 3),
    Law("DEM, Kumar", 1.67, 2.7, 2 / 3),
    Law("μ(I) continuum, Lagrée et al. 2011", 2.2, 3.9, 0.7),
)
"""As tabulated by secondary sources; experiments first."""
