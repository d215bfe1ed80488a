"""Clock estimation against a true offset: is the bound true, how wide is it, how soon is a restart over.

First the estimator alone behind synthetic links, then with our adapter against the simulated autopilot.
"""

from __future__ import annotations

import numpy as np

from companion.core.clock.bank import ClockBank
from tools.bench import clock_flight
from tools.bench.clock_link import MS, Flight, Link, S, fly

FLIGHTS = 10
DURATION_S = 60
TARGET_TRUE = 0.999
TARGET_EXCESS_MS = 0.3
TARGET_ERROR_MS = 0.3
TARGET_LOCK_S = 3.0


def run(flights: int = FLIGHTS) -> list[dict[str, float | str]]:
    """Give a row per link: share of true bounds, median bound over half the least round trip, error, worst lock."""
    return [
        _row("10.7 ms, as of a 50 Hz loop", flights, jitter_ns=10e6, fixed_ns=0.7e6),
        _row("3 ms, as of a 400 Hz loop", flights, jitter_ns=2.7e6, fixed_ns=0.3e6),
        _row("0-30 ms jitter each way", flights, jitter_ns=30e6, fixed_ns=0.3e6),
    ]


def main(arguments: list[str] | None = None) -> int:
    del arguments
    print(f"20 % loss each way, 10 Hz, skew 10 ms/min; one restart in {2 * DURATION_S} s; {FLIGHTS} flights each")
    rows = run()
    _print(rows)
    print(f"the adapter in flight, {clock_flight.DURATION_S:g} s each, restarts once; same loss and skew")
    flown = clock_flight.run()
    _print(flown)
    print(
        f"targets: bound true >= {100 * TARGET_TRUE:g} %, over RTT/2 <= {TARGET_EXCESS_MS:g} ms, "
        f"lock < {TARGET_LOCK_S:g} s, error <= {TARGET_ERROR_MS:g} ms at a 400 Hz loop"
    )
    good = all(
        float(row["true"]) >= TARGET_TRUE
        and float(row["excess_ms"]) <= TARGET_EXCESS_MS
        and float(row["lock_s"]) < TARGET_LOCK_S
        for row in rows + flown
    )
    exact = all(float(row["error_ms"]) <= TARGET_ERROR_MS for row in (rows[1], flown[0]))
    return int(not (good and exact))


def _print(rows: list[dict[str, float | str]]) -> None:
    print(f"{'link':30s} {'bound true':>10s} {'bound':>9s} {'over RTT/2':>11s} {'error rms':>10s} {'lock':>7s}")
    for row in rows:
        print(
            f"{row['name']:30s} {100 * float(row['true']):9.2f}% {row['bound_ms']:6.2f} ms {row['excess_ms']:+8.2f} ms "
            f"{row['error_ms']:7.3f} ms {row['lock_s']:5.2f} s"
        )


def _row(name: str, flights: int, jitter_ns: float, fixed_ns: float) -> dict[str, float | str]:
    flown: list[Flight] = []
    for seed in range(flights):
        bank = ClockBank()
        first = Link(seed, jitter_ns=jitter_ns, fixed_ns=fixed_ns)
        again = Link(seed + flights, jitter_ns=jitter_ns, fixed_ns=fixed_ns)
        again.start_ns, again.epoch_ns = first.start_ns + DURATION_S * S, 0
        flown += [fly(bank, first, DURATION_S), fly(bank, again, DURATION_S)]
    error, bound = (np.concatenate([getattr(flight, what) for flight in flown]) for what in ("error_ns", "bound_ns"))
    return {
        "name": name,
        "true": float(np.mean(error <= bound)),
        "bound_ms": float(np.median(bound)) / MS,
        "excess_ms": float(np.median(np.concatenate([flight.excess_ns for flight in flown]))) / MS,
        "error_ms": float(np.sqrt(np.mean(np.square(error.astype(float))))) / MS,
        "lock_s": max(flight.locked_after_s for flight in flown),
    }


if __name__ == "__main__":
    raise SystemExit(main())
