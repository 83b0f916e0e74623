"""Sensors of future experiments: the present ones, and further ones that are available."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from feltmb.data import Sensor
from feltmb.errors import InvalidParameter
from feltmb.fit.limits import FurtherSensor
from feltmb.fit.model import Model
from feltmb.gap.criteria import BETTER_SENSOR
from feltmb.style import reader_unit
from feltmb.units import unit_suffix

__all__ = ["Sensors", "offered"]


@dataclass(frozen=True)
class Sensors:
    """What experiments are measured with."""

    now: Mapping[str, Sensor]
    """By output."""
    offers: tuple[FurtherSensor, ...] = ()
    """Further sensors that are available, each with its noise."""

    @property
    def all(self) -> dict[str, Sensor]:
        """The least noisy sensor of each output, with all available sensors."""
        out = self
        for offer in self.offers:
            sigma = out.now[offer.output].sigma if offer.output in out.now else None
            if sigma is None or float(offer.sigma or 0.0) < sigma:
                out = out.having(offer)
        return dict(out.now)

    @property
    def ways(self) -> list[dict[str, float]]:
        """Noise by output in multiples of that of ``all``: now, with each offer, with all."""
        best = self.all
        sets = [self.now, *(self.having(o).now for o in self.offers)]
        if len(self.offers) > 1:
            sets.append(best)
        return [
            {
                n: 1.0 if s.sigma is None else s.sigma / (best[n].sigma or 1.0)
                for n, s in own.items()
            }
            for own in sets
        ]

    def having(self, offer: FurtherSensor) -> Sensors:
        """With one of the offers, and without those that are then no better."""
        assert offer.sigma is not None
        old = self.now.get(offer.output)
        if old is None:
            new = Sensor(name=offer.output, sigma=offer.sigma)
        else:
            assert old.sigma is not None
            share = offer.sigma / old.sigma  # less noise of the same color
            new = replace(
                old,
                sigma=offer.sigma,
                relative_sigma=share * old.relative_sigma,
                quantum=share * old.quantum,
                colored_sigma=share * old.colored_sigma,
            )
        left = tuple(
            o
            for o in self.offers
            if o.output != offer.output or (o.sigma is not None and o.sigma < offer.sigma)
        )
        return Sensors({**self.now, offer.output: new}, left)

    def answered(self, asked: FurtherSensor, sigma: float) -> Sensors:
        """With the sensor that was asked for and has this noise, which is not offered again.

        The present sensor is kept if it has less noise.
        """
        old = self.now.get(asked.output)
        best = sigma if old is None or old.sigma is None else min(sigma, old.sigma)
        left = tuple(
            o
            for o in self.offers
            if (o.output, o.sigma, o.how) != (asked.output, asked.sigma, asked.how)
        )
        return Sensors(self.now, left).having(replace(asked, sigma=best))

    def words(self, offer: FurtherSensor, unit: str) -> str:
        """Name of an offer with its noise."""
        factor, shown = reader_unit(unit)
        own = unit_suffix(shown)
        noise = f"noise {factor * float(offer.sigma or 0.0):.3g}{own}"
        if offer.output in self.now:
            noise += f" in place of {factor * float(self.now[offer.output].sigma or 0.0):.3g}{own}"
        what = offer.how or ("less noisy sensor" if offer.output in self.now else "further sensor")
        return f"{what}: {offer.output}, {noise}"


def offered(
    further: Sequence[FurtherSensor], now: Mapping[str, Sensor], model: Model
) -> tuple[FurtherSensor, ...]:
    """Available further sensors, each with its noise.

    Raises
    ------
    InvalidParameter
        The noise of a sensor is not given and does not follow from the others, or a sensor is not
        better than the present one.
    """
    faults, out = [], []
    for offer in further:
        sigma = offer.sigma
        unit = model.units.get(offer.output) or "1"
        if offer.output in now:
            present = now[offer.output].sigma
            if present is None:
                faults.append(
                    f"{offer.output}: is already measured by a sensor with unknown noise; expected "
                    f"its sigma in [sensors.{offer.output}]"
                )
                continue
            sigma = present / BETTER_SENSOR if sigma is None else sigma
            if not sigma < present:
                own = unit_suffix(unit)
                faults.append(
                    f"{offer.output}: sigma = {sigma:g}{own}, expected less than that of its "
                    f"present sensor, {present:g}{own}"
                )
                continue
        elif sigma is None:
            alike = [
                s.sigma
                for n, s in now.items()
                if s.sigma is not None and unit != "1" and model.units.get(n) == unit
            ]
            if not alike:
                faults.append(
                    f"{offer.output}: its noise is not given; expected sigma, because no sensor "
                    f"with known noise measures in {unit if unit != '1' else 'its unit'}"
                )
                continue
            sigma = max(alike)
        out.append(replace(offer, sigma=sigma))
    if faults:
        raise InvalidParameter("further sensors: " + "; ".join(faults))
    return tuple(out)
