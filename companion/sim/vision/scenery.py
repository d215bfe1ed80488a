"""Ground of a world: houses and trees beside the path, ploughed rows, snow, water."""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from companion.sim.flight.flight import Flight
from companion.sim.flight.truth import FlightTruth
from companion.sim.flight.worlds import Ground
from companion.sim.vision.scene import Plane, Scene, board, ground, ground_scene, obstacle_scene, terrace

CONTRAST: dict[Ground, float] = {
    # from photographs: fresh snow under cloud has a tenth to a fifth of a meadow's rms contrast, a lake less
    Ground.SNOW: 0.15,
    Ground.WATER: 0.04,
}
"""Contrast of the ground's texture over that of meadow, where it is not 1."""

_FURROW = 12.0  # length of a clod along the furrow over its width (a plough's; choice)
_SNOW_LEVEL = 205.0  # grey level of snow where meadow has 118 (choice)
_BESIDE_M = 60.0  # to either side of the path: what a 44 deg lens sees from 100 m, and half as much again (choice)
_HOUSE_EVERY_M, _TREE_EVERY_M, _FOREST_EVERY_M = 60.0, 25.0, 8.0  # chosen: a village's houses, its trees, and a wood's
_SURFACES = 1000  # numbers of surfaces for what stands on the ground, apart from the scene's own (convention)


def scene_of(flight: Flight) -> Scene:
    """The ground for a pair that looks down, obstacles for one that looks ahead, in the flight's world."""
    plain = ground_scene(flight.seed) if flight.airframe.looks_down else obstacle_scene(flight.truth, flight.seed)
    rng = flight.generator("ground")
    kind = flight.world.grounds[int(rng.integers(len(flight.world.grounds)))]
    return plain if kind is Ground.PLAIN else clad(plain, kind, flight.truth, rng)


def clad(plain: Scene, kind: Ground, truth: FlightTruth, rng: np.random.Generator) -> Scene:
    """A scene whose endless ground is of a kind, with what stands on it along the path."""
    meadow = ground()
    floor = dataclasses.replace(
        meadow,
        contrast=CONTRAST.get(kind, 1.0),
        furrow=_FURROW if kind is Ground.ROWS else 1.0,
        brightness=_SNOW_LEVEL if kind is Ground.SNOW else meadow.brightness,
    )
    planes = [floor if plane.half_size_m is None else plane for plane in plain.planes]
    if kind in (Ground.VILLAGE, Ground.SNOW):
        for north_m, east_m in _places(truth, _HOUSE_EVERY_M, rng):
            planes += _house(north_m, east_m, rng, _SURFACES + len(planes))
    every_m = {Ground.VILLAGE: _TREE_EVERY_M, Ground.FOREST: _FOREST_EVERY_M}.get(kind)
    if every_m is not None:
        for north_m, east_m in _places(truth, every_m, rng):
            planes.append(_crown(north_m, east_m, rng, _SURFACES + len(planes)))
    return dataclasses.replace(plain, planes=tuple(planes))


def _places(truth: FlightTruth, every_m: float, rng: np.random.Generator) -> list[tuple[float, float]]:
    """Places beside the path, one every so many metres of it."""
    path = truth.series(truth.t_boot_ns[::20]).position_ned_m[:, :2]
    flown = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
    at = np.searchsorted(flown, np.arange(0.0, flown[-1], every_m))
    spots = path[np.minimum(at, len(path) - 1)] + rng.uniform(-_BESIDE_M, _BESIDE_M, (len(at), 2))
    return [(float(north), float(east)) for north, east in spots]


def _house(north_m: float, east_m: float, rng: np.random.Generator, surface: int) -> list[Plane]:
    """A flat-roofed house: roof and four walls, along the compass."""
    length_m, width_m, height_m = rng.uniform(8.0, 16.0), rng.uniform(7.0, 12.0), rng.uniform(4.0, 9.0)
    roof = terrace(north_m, east_m, (length_m, width_m), height_m, surface)
    walls = []
    for number, (turn, depth_m, broad_m) in enumerate(((0.0, length_m, width_m), (0.5 * math.pi, width_m, length_m))):
        ahead = 0.5 * depth_m * np.array([math.cos(turn), math.sin(turn), 0.0])
        for sign in (-1.0, 1.0):
            centre = np.array([north_m, east_m, -0.5 * height_m]) + sign * ahead
            walls.append(board(centre, turn, (broad_m, height_m), surface + 1 + number))
    return [roof, *walls]


def _crown(north_m: float, east_m: float, rng: np.random.Generator, surface: int) -> Plane:
    """A tree as its crown: a level square above the ground."""
    size_m = rng.uniform(3.0, 7.0)
    crown = terrace(north_m, east_m, (size_m, size_m), rng.uniform(4.0, 15.0), surface)
    return dataclasses.replace(crown, brightness=90.0, contrast=1.5)
