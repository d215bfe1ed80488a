"""Takes named effects of the sensors out of samples as they come in, so that the tracker sees what is true.

Scale, bias and lateness are undone sample by sample. What is no matter of single samples (a filter, a law of the
sensors that bends) stays.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field

from companion.core.wing.effect import Effect
from companion.core.wing.effects import apply_to_airframe, make_effect
from companion.params.airframe import Airframe
from companion.records import ImuBatch, Station


@dataclass(frozen=True, slots=True)
class SampleCorrections:
    """Effects in force (in the order in which they act), and what is added to stamps, by station."""

    effects: tuple[Effect, ...] = ()
    shift_ns: dict[Station, int] = field(default_factory=dict)

    @classmethod
    def of(cls, airframe: Airframe) -> SampleCorrections:
        """Corrections of an airframe's named effects."""
        effects = tuple(make_effect(entry) for entry in airframe.effects)
        applied = apply_to_airframe(airframe)
        late_s = {
            station: applied.sensor(station).source.stamp_offset_s - airframe.sensor(station).source.stamp_offset_s
            for station in Station
        }
        return cls(effects, {station: round(shift * 1e9) for station, shift in late_s.items() if shift})

    def corrected(self, batch: ImuBatch) -> ImuBatch:
        """The samples as a sensor without these effects would have sent them."""
        values, shift_ns = batch.values, self.shift_ns.get(batch.station, 0)
        for effect in reversed(self.effects):
            values = effect.undone(batch.station, values)
        if values is batch.values and not shift_ns:
            return batch
        return dataclasses.replace(batch, t_ns=batch.t_ns + shift_ns, values=values)
