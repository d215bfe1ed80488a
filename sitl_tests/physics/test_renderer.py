"""The renderer that judges: disparity, blur and ranges against geometry, measured in the images themselves."""

from __future__ import annotations

import dataclasses

import cv2
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.ndimage import map_coordinates
from scipy.spatial.transform import Rotation

from companion.params.airframe import Airframe, Camera
from companion.params.files import load_airframe
from companion.records import Side
from companion.sim.vision.renderer import ExposureInterval, Renderer
from companion.sim.vision.scene import PosedCamera, Scene, board, ground, ground_scene, obstacle_scene, terrace
from companion.sim.vision.shutter import PixelGrid
from companion.sim.vision.texture import CENTRE_PER_TEXEL, NoiseTile, noise_period
from companion.sim.vision.textured_plane import SurfacePainter
from sitl_tests.physics.camera_flight import MIDDLE_NS, Path, fly
from sitl_tests.physics.true_range import TrueRangeProduct, overlap_depths_m, true_range_m

NADIR = load_airframe("nadir-2m")
EXPOSURE = ExposureInterval(MIDDLE_NS, 2_000_000)
INSTANT = ExposureInterval(MIDDLE_NS, 0)


def _with_cameras(airframe: Airframe, **changes: object) -> Airframe:
    left, right = airframe.left_camera, airframe.right_camera
    assert isinstance(left, Camera)
    assert isinstance(right, Camera)
    return dataclasses.replace(
        airframe, left_camera=dataclasses.replace(left, **changes), right_camera=dataclasses.replace(right, **changes)
    )


FORWARD = _with_cameras(NADIR, axes=("y", "z", "x"))


def _pixels(shape: tuple[int, int]) -> np.ndarray:
    columns, rows = np.meshgrid(np.arange(shape[1], dtype=float), np.arange(shape[0], dtype=float))
    return np.stack([columns, rows], axis=-1).reshape(-1, 2)


def _shifts(reference: np.ndarray, other: np.ndarray, where: np.ndarray, block: int = 24) -> np.ndarray:
    """Offset in pixels (x, y) of ``other`` from its predicted place ``where`` in each block, (n, 2).

    One least-squares step on the mean of both gradients, which near zero is unbiased; blocks that leave either image
    are left out. ``where`` (rows, columns, 2) are the places in ``other`` of the reference's pixels.
    """
    rows, columns = reference.shape
    # a spline of order 5 at exact places; OpenCV's Lanczos rounds them to 1/32 px
    moved = map_coordinates(other.astype(np.float64), where[..., ::-1].transpose(2, 0, 1), order=5, mode="nearest")
    inside = np.all((where > 6) & (where < (columns - 7, rows - 7)), axis=-1)
    inside = cv2.erode(inside.astype(np.uint8), np.ones((13, 13)), borderValue=0) > 0
    first, second = (cv2.GaussianBlur(image.astype(np.float32), (0, 0), 1.0) for image in (reference, moved))
    mean = 0.5 * (first + second)
    gradient = np.stack([np.gradient(mean, axis=1), np.gradient(mean, axis=0)], axis=-1)
    offsets_px = []
    for y in range(0, rows - block + 1, block):
        for x in range(0, columns - block + 1, block):
            cut = np.s_[y : y + block, x : x + block]
            if inside[cut].all():
                slopes = gradient[cut].reshape(-1, 2)
                difference = (first - second)[cut].ravel()
                slopes, difference = slopes - slopes.mean(axis=0), difference - difference.mean()
                offsets_px.append(np.linalg.lstsq(slopes, difference, rcond=None)[0])
    return np.array(offsets_px)


def _predicted(scene: Scene, view: PosedCamera, other: PosedCamera) -> np.ndarray:
    width, height = view.camera.lens.size_px
    points = view.points_ned_m(scene, _pixels((height, width)))
    return other.project(points).reshape(height, width, 2)


def _pair_shifts(
    airframe: Airframe, path: Path, scene: Scene, seed: int, exposure: ExposureInterval = EXPOSURE
) -> np.ndarray:
    renderer = Renderer(airframe, fly(airframe, path), scene, seed)
    left, right = (renderer.render(side, exposure, seed) for side in Side)
    views = [renderer.view(side, exposure.mid_boot_ns) for side in Side]
    return _shifts(left, right, _predicted(scene, *views))


# ------------------------------------------------------------------------------------------------ disparity


def _distances(*distances_m: float, between: tuple[float, ...]) -> list[object]:
    """Both ends and the middle of the range every time, what lies ``between`` where there is time."""
    return [*distances_m, *(pytest.param(distance_m, marks=pytest.mark.slow) for distance_m in between)]


@pytest.mark.slow
@pytest.mark.parametrize("distance_m", _distances(4.0, 20.0, 100.0, between=(6.0, 10.0, 40.0, 60.0)))
def test_nadir_disparity_with_true_extrinsics_is_unbiased_to_a_hundredth_of_a_pixel(distance_m: float) -> None:
    shifts_by_seed = [
        _pair_shifts(
            NADIR, Path(distance_m, 22.0, trim_m=0.0149, swing_m=0.005, roll_rate_radps=0.1), ground_scene(seed), seed
        )
        for seed in range(3)
    ]
    shifts = np.vstack(shifts_by_seed)
    error = shifts.mean(axis=0)
    standard = shifts.std(axis=0) / np.sqrt(len(shifts))
    assert len(shifts) > 150
    assert np.all(standard < 0.003)  # fine enough to see a hundredth
    assert np.all(np.abs(error) < 0.01)


@pytest.mark.slow
@pytest.mark.parametrize("distance_m", _distances(4.0, 100.0, between=(12.0, 30.0)))
def test_forward_disparity_on_a_board_is_unbiased_too(distance_m: float) -> None:
    wide = board(np.array([distance_m, 0.0, -60.0]), 0.0, (1.2 * distance_m + 4.0, distance_m), 5)
    shifts_by_seed = [
        _pair_shifts(FORWARD, Path(60.0, 22.0, trim_m=0.0149, swing_m=0.004), Scene((ground(), wide), seed), seed)
        for seed in range(3)
    ]
    shifts = np.vstack(shifts_by_seed)
    assert np.all(shifts.std(axis=0) / np.sqrt(len(shifts)) < 0.004)
    assert np.all(np.abs(shifts.mean(axis=0)) < 0.01)


@pytest.mark.slow
def test_there_is_no_pixel_locking() -> None:
    """Shifts by tenths of a pixel are found as tenths of a pixel: no pull toward whole or half ones."""
    scene, distance = ground_scene(7), 20.0
    pixel_m = distance / 800.0
    first = Renderer(NADIR, fly(NADIR, Path(distance)), scene, 1)
    reference = first.render(Side.LEFT, INSTANT, 0)
    errors = []
    for tenth in range(1, 11):
        moved = Renderer(NADIR, fly(NADIR, Path(distance, east_m=0.1 * tenth * pixel_m)), scene, 2)
        image = moved.render(Side.LEFT, INSTANT, tenth)
        upper = image[:240]
        predicted = _pixels(upper.shape).reshape(*upper.shape, 2) - (0.1 * tenth, 0.0)
        errors.append(_shifts(reference[:240], upper, predicted).mean(axis=0))
    assert np.abs(errors).max() < 0.005


def test_a_point_of_the_world_looks_alike_from_far_apart() -> None:
    """The same ground from another place, height and bank: texture belongs to the world, not to the image."""
    scene = ground_scene(3)
    level = Renderer(NADIR, fly(NADIR, Path(20.0)), scene, 1)
    banked = Renderer(NADIR, fly(NADIR, Path(23.0, east_m=1.7, roll_rad=0.15)), scene, 2)
    views = [renderer.view(Side.LEFT, MIDDLE_NS) for renderer in (level, banked)]
    images = [renderer.render(Side.LEFT, INSTANT, 0) for renderer in (level, banked)]
    shifts = _shifts(*images, _predicted(scene, *views))
    assert len(shifts) > 100
    assert np.abs(shifts.mean(axis=0)).max() < 0.01
    assert np.sqrt(np.mean(shifts**2)) < 0.05


@pytest.mark.slow
def test_lens_distortion_is_the_rigs() -> None:
    bent = _with_cameras(NADIR, distortion=(-0.25, 0.08, 0.001, -0.0015, 0.01))
    shifts = _pair_shifts(bent, Path(30.0, 22.0, trim_m=0.0149), ground_scene(4), 4)
    assert len(shifts) > 100
    assert np.abs(shifts.mean(axis=0)).max() < 0.01
    # and against a straight lens, by the pixels' rays alone
    scene, path = ground_scene(4), Path(30.0)
    straight, curved = (Renderer(airframe, fly(airframe, path), scene, 1) for airframe in (NADIR, bent))
    images = [renderer.render(Side.RIGHT, INSTANT, 0) for renderer in (straight, curved)]
    lens = curved.rig.right.lens
    rays = straight.rig.right.lens.unproject(_pixels(images[0].shape))
    where = lens.project(rays).reshape(*images[0].shape, 2)
    assert np.abs(where - _pixels(images[0].shape).reshape(where.shape)).max() > 5.0
    between = _shifts(*images, where)
    assert np.abs(between.mean(axis=0)).max() < 0.01
    assert np.sqrt(np.mean(between**2)) < 0.05


# ------------------------------------------------------------------------------------------------ blur and time


def _blurred_by_hand(renderer: Renderer, path_ns: int, count: int = 41) -> np.ndarray:
    """Mean of instantaneous images over the exposure."""
    offsets = ((np.arange(count) + 0.5) / count - 0.5) * path_ns
    images = [renderer.render(Side.LEFT, ExposureInterval(MIDDLE_NS + int(dt), 0), i) for i, dt in enumerate(offsets)]
    return np.mean(images, axis=0)


@pytest.mark.slow
@pytest.mark.parametrize(
    "path", [Path(20.0, 22.0), Path(20.0, 0.0, roll_rate_radps=1.0), Path(8.0, 22.0, climb_mps=4.0)]
)
def test_blur_is_the_mean_over_the_exposure(path: Path) -> None:
    renderer = Renderer(NADIR, fly(NADIR, path), ground_scene(5), 1)
    expected = _blurred_by_hand(renderer, EXPOSURE.exposure_ns)
    sharp = renderer.render(Side.LEFT, INSTANT, 99).astype(float)
    image = renderer.render(Side.LEFT, EXPOSURE, 0).astype(float)
    noise = np.sqrt((0.8**2 + 0.012 * expected.mean() + 1.0 / 12.0) * (1.0 + 1.0 / 41.0))
    assert np.sqrt(np.mean((image - expected) ** 2)) == pytest.approx(noise, rel=0.03)
    assert np.sqrt(np.mean((sharp - expected) ** 2)) > 1.2 * noise  # the blur is there


@pytest.mark.parametrize("swing_m", [0.0, 0.012])
def test_blur_is_centred_on_mid_exposure(swing_m: float) -> None:
    path = Path(15.0, 22.0, roll_rate_radps=0.5, swing_m=swing_m)
    renderer = Renderer(NADIR, fly(NADIR, path), ground_scene(6), 1)
    image = renderer.render(Side.LEFT, ExposureInterval(MIDDLE_NS, 3_000_000), 0)
    sharp = renderer.render(Side.LEFT, INSTANT, 1)
    still = _pixels(image.shape).reshape(*image.shape, 2)
    assert np.abs(_shifts(sharp, image, still).mean(axis=0)).max() < 0.01
    later = renderer.render(Side.LEFT, ExposureInterval(MIDDLE_NS + 50_000, 3_000_000), 2)
    moved = _shifts(sharp, later, still).mean(axis=0)
    assert np.hypot(*moved) > 0.03  # 50 us late would show


def test_a_rolling_shutter_sees_every_row_at_its_own_time() -> None:
    """Flying forward the ground moves down the image at v; a row y' at its own time shows what y showed at the middle:
    y' = y + v (y' - 239.5) row_time."""
    row_ns, speed, distance = 20_000, 22.0, 20.0
    renderer = Renderer(NADIR, fly(NADIR, Path(distance, speed)), ground_scene(8), 1)
    rolling = renderer.render(Side.LEFT, ExposureInterval(MIDDLE_NS, 500_000, row_ns), 0)
    global_shutter = renderer.render(Side.LEFT, ExposureInterval(MIDDLE_NS, 500_000), 1)
    stretch = speed * row_ns * 1e-9 * 800.0 / distance
    where = _pixels(global_shutter.shape).reshape(*global_shutter.shape, 2)
    where[..., 1] = (where[..., 1] - 239.5 * stretch) / (1.0 - stretch)
    shifts = _shifts(global_shutter, rolling, where)
    assert np.abs(shifts.mean(axis=0)).max() < 0.01
    assert np.sqrt(np.mean(shifts**2)) < 0.05
    assert np.abs(where[:, 0, 1] - np.arange(480)).max() > 4.0


# ------------------------------------------------------------------------------------------------ image and scene


def test_images_are_deterministic_and_differ_by_noise_alone_between_shots() -> None:
    def image(seed: int, shot: int) -> np.ndarray:
        return Renderer(NADIR, fly(NADIR, Path(30.0)), ground_scene(1), seed).render(Side.LEFT, INSTANT, shot)

    first = image(1, 0)
    assert first.dtype == np.uint8
    assert first.shape == (480, 640)
    assert np.array_equal(first, image(1, 0))
    difference = first.astype(float) - image(1, 1)
    assert difference.mean() == pytest.approx(0.0, abs=0.02)
    # two independent noises of sqrt(0.8^2 + 0.012 * grey) and two roundings
    expected = np.sqrt(2.0 * (0.8**2 + 0.012 * first.mean() + 1.0 / 12.0))
    assert difference.std() == pytest.approx(expected, rel=0.02)
    assert not np.array_equal(first, image(2, 0))


def test_contrast_is_natural_from_any_height() -> None:
    for altitude in (4.0, 20.0, 100.0):
        image = Renderer(NADIR, fly(NADIR, Path(altitude)), ground_scene(2), 1).render(Side.LEFT, INSTANT, 0)
        assert 15.0 < image.std() < 45.0
        assert 80.0 < image.mean() < 160.0
        assert np.mean((image == 0) | (image == 255)) < 0.01


def test_the_ground_does_not_repeat_along_the_flight() -> None:
    scene = ground_scene(9)
    images = []
    for north in range(0, 60, 5):
        truth = fly(NADIR, Path(15.0))
        truth.knots[:, 0] = 97.0 * north
        image = Renderer(NADIR, truth, scene, 1).render(Side.LEFT, INSTANT, 0).astype(float)
        images.append((image - image.mean()).ravel() / image.std())
    correlation = np.corrcoef(images) - np.eye(len(images))
    assert np.abs(correlation).max() < 0.5


def test_one_octave_of_noise_keeps_to_its_band() -> None:
    tile = noise_period(3)
    assert abs(tile.mean()) < 1e-5
    assert tile.std() == pytest.approx(1.0, rel=1e-4)
    power = np.abs(np.fft.rfft2(tile)) ** 2
    fx, fy = np.meshgrid(np.fft.rfftfreq(tile.shape[1]), np.fft.fftfreq(tile.shape[0]))
    octave = np.log2(np.maximum(np.hypot(fx, fy), 1e-9) / CENTRE_PER_TEXEL)
    assert power[np.abs(octave) > 1.0].sum() < 1e-9 * power.sum()
    rings = [power[(octave > low) & (octave < low + 0.2)].sum() for low in (-0.5, -0.1, 0.3)]
    assert rings[0] / rings[2] == pytest.approx(1.0, rel=0.05)  # equal power each way of the centre


def _edge_column(image: np.ndarray, row: int, low: int, high: int) -> float:
    """Column at which brightness steps, from the area under the step."""
    line = image[row - 8 : row + 8, low:high].astype(float).mean(axis=0)
    dark, bright = line[:4].mean(), line[-4:].mean()
    return low - 0.5 + np.sum((bright - line) / (bright - dark))


@pytest.mark.parametrize("offset_m", [0.0, 0.003, 0.0071])
def test_the_edge_of_a_board_lies_where_it_projects(offset_m: float) -> None:
    plain = dataclasses.replace(board(np.array([10.0, 0.0, -60.0]), 0.0, (2.0 + offset_m, 3.0), 1), brightness=60.0)
    renderer = Renderer(FORWARD, fly(FORWARD, Path(60.0)), Scene((plain,), 1), 1)
    image = renderer.render(Side.LEFT, INSTANT, 0)
    corner = renderer.view(Side.LEFT, MIDDLE_NS).project(plain.corners_m())
    right_edge = float(corner[:, 0].max())
    edge_px = np.mean(
        [_edge_column(image, row, int(right_edge) - 12, int(right_edge) + 12) for row in range(160, 320, 8)]
    )
    assert edge_px == pytest.approx(right_edge, abs=0.6)  # the texture under the step blurs the measure, not the place
    assert image[5, 5] == pytest.approx(200, abs=8)


def test_a_near_board_hides_a_far_one_and_the_ground() -> None:
    near = dataclasses.replace(board(np.array([10.0, 0.0, -60.0]), 0.0, (2.0, 2.0), 1), brightness=30.0)
    far = dataclasses.replace(board(np.array([40.0, 0.0, -60.0]), 0.0, (30.0, 20.0), 2), brightness=220.0)
    for planes in ((near, far, ground()), (far, ground(), near)):
        renderer = Renderer(FORWARD, fly(FORWARD, Path(60.0)), Scene(planes, 1), 1)
        image = renderer.render(Side.LEFT, INSTANT, 0).astype(float)
        view = renderer.view(Side.LEFT, MIDDLE_NS)
        depths = view.depth_m(renderer.scene, _pixels(image.shape)).reshape(image.shape)
        assert image[np.abs(depths - 10.0) < 1e-6].mean() < 80.0
        assert image[np.abs(depths - 40.0) < 1e-6].mean() > 180.0
        assert 90.0 < image[np.isfinite(depths) & (depths > 41.0)].mean() < 150.0


@pytest.mark.parametrize("near_m", [20.0, 32.0, 45.0])
@pytest.mark.parametrize("east_m", [0.0, -7.5, -12.1])
def test_leaving_out_what_is_hidden_changes_no_pixel(near_m: float, east_m: float) -> None:
    """Boards one behind another, wholly hidden or showing by some pixels past the nearer one's edge, in a roll."""
    boards = [board(np.array([near_m * n, 0.0, -60.0]), 0.0, (30.0, 20.0), n) for n in (4, 3, 2, 1)]
    planes = [ground(), *boards]
    path = Path(60.0, 25.0, east_m, roll_rate_radps=0.8, swing_m=0.005)
    renderer = Renderer(FORWARD, fly(FORWARD, path), Scene(tuple(planes), 1), 1)
    painter, grid = SurfacePainter(NoiseTile(1), 1), PixelGrid(renderer.rig.left.lens)
    track = grid.track(2_000_000, 0)
    views = renderer.views(Side.LEFT, MIDDLE_NS + track.offsets_ns)
    together, one_by_one = (np.full((480, 640), 200.0, np.float32) for _ in range(2))
    painter.paint(together, planes, views, grid, track)
    for plane in planes:
        painter.paint(one_by_one, [plane], views, grid, track)
    assert np.max(np.abs(together - one_by_one)) < 1e-3


@pytest.mark.long
@settings(max_examples=60, deadline=None)
@given(
    bend=st.floats(-0.25, 0.1),
    tangential=st.floats(-2e-3, 2e-3),
    low=st.tuples(st.floats(-0.9, 0.6), st.floats(-0.7, 0.4)),
    size=st.tuples(st.floats(0.01, 1.5), st.floats(0.01, 1.2)),
)
def test_a_bent_lens_has_all_pixels_of_a_surface_in_its_window(
    bend: float, tangential: float, low: tuple[float, float], size: tuple[float, float]
) -> None:
    """Rays of every fourth pixel: those in the box lie in its window, and where there is no window none does."""
    lens = dataclasses.replace(
        Renderer(NADIR, fly(NADIR, Path(60.0)), ground_scene(1), 1).rig.left.lens,
        distortion=np.array([bend, 0.05, tangential, -tangential, 0.0]),
    )
    pixels = _pixels(lens.size_px[::-1])[::4]
    rays = lens.unproject(pixels)[:, :2]
    box = np.array(low), np.array(low) + size
    inside = np.all((rays >= box[0]) & (rays <= box[1]), axis=1)
    window = PixelGrid(lens).window_of_rays(*box)
    if window is None:
        assert not inside.any()
        return
    first = np.array([window.column, window.row])
    assert np.all((pixels[inside] >= first) & (pixels[inside] < first + np.array([window.width, window.height])))


@pytest.mark.slow
@settings(max_examples=60, deadline=None)
@example(centre=(0.0, 5.25, 11.0), turns=(0.0, 1.0, 0.0), half=(3.0, 1.0))  # in the margin alone
@given(
    centre=st.tuples(st.floats(-30.0, 30.0), st.floats(-30.0, 30.0), st.floats(-20.0, 40.0)),
    turns=st.tuples(*[st.floats(-np.pi, np.pi)] * 3),
    half=st.tuples(st.floats(1.0, 20.0), st.floats(1.0, 20.0)),
)
def test_a_wall_that_passes_the_camera_has_all_its_pixels_in_its_window(
    centre: tuple[float, float, float], turns: tuple[float, float, float], half: tuple[float, float]
) -> None:
    """Every pixel whose ray meets the wall in front of the camera; a wall that none meets is not painted at all."""
    grid = PixelGrid(Renderer(NADIR, fly(NADIR, Path(60.0)), ground_scene(1), 1).rig.left.lens)
    across, along, normal = Rotation.from_euler("xyz", turns).as_matrix()
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * half @ np.stack([across, along]) + centre
    pixels = _pixels(grid.size_px[::-1])[::4]
    rays = grid.lens.unproject(pixels)
    with np.errstate(divide="ignore", invalid="ignore"):
        points = rays * ((normal @ np.array(centre)) / (rays @ normal))[:, None]
    place = (points - centre) @ np.stack([across, along]).T
    meets = (points[:, 2] > 0.1) & np.all(np.abs(place) <= half, axis=1)
    clipped = grid.clipped(corners)
    outline = clipped[:, :2] / clipped[:, 2:]
    window = grid.window_of_rays(outline.min(axis=0), outline.max(axis=0)) if len(clipped) else None
    if window is None:  # out of sight, or only in the pyramid's margin around the image
        assert not meets.any()
        return
    first = np.array([window.column, window.row])
    assert np.all((pixels[meets] >= first) & (pixels[meets] < first + np.array([window.width, window.height])))


# ------------------------------------------------------------------------------------------------ true ranges


def _views(airframe: Airframe, path: Path) -> tuple[PosedCamera, PosedCamera]:
    renderer = Renderer(airframe, fly(airframe, path), ground_scene(1), 1)
    return renderer.view(Side.LEFT, MIDDLE_NS), renderer.view(Side.RIGHT, MIDDLE_NS)


def test_true_range_over_level_ground_is_the_cameras_height() -> None:
    for product in TrueRangeProduct:
        assert true_range_m(ground_scene(1), *_views(NADIR, Path(60.0)), product) == pytest.approx(60.0)
    # trim bend lifts both cameras by as much
    assert true_range_m(ground_scene(1), *_views(NADIR, Path(60.0, trim_m=0.0149))) == pytest.approx(60.0149, abs=1e-3)


def test_true_range_in_a_bank_is_longer_by_the_cosine_at_the_centre() -> None:
    views = _views(NADIR, Path(60.0, roll_rad=0.4))
    assert true_range_m(ground_scene(1), *views, TrueRangeProduct.CENTRE) == pytest.approx(60.0 / np.cos(0.4))
    assert true_range_m(ground_scene(1), *views, TrueRangeProduct.NEAREST) < 60.0 / np.cos(0.4)


def test_a_terrace_is_nearest_but_not_the_median() -> None:
    scene = Scene((ground(), terrace(4.0, 0.0, (3.0, 20.0), 5.0, 1)), 1)
    views = _views(NADIR, Path(30.0))
    assert true_range_m(scene, *views, TrueRangeProduct.NEAREST) == pytest.approx(25.0)
    assert true_range_m(scene, *views, TrueRangeProduct.MEDIAN) == pytest.approx(30.0)


def test_only_what_both_cameras_see_counts() -> None:
    views = _views(NADIR, Path(4.0))
    # at 4 m the images share 640 - 396 of their 640 columns
    depths = overlap_depths_m(ground_scene(1), *views, grid=(640, 4))
    assert len(depths) / (640 * 4) == pytest.approx(244 / 640, abs=2 / 640)
    assert true_range_m(ground_scene(1), *_views(NADIR, Path(2.0))) == np.inf  # 792 px of disparity: no overlap


def test_what_is_lost_in_the_haze_is_neither_painted_nor_ranged() -> None:
    wall = board(np.array([120.0, 0.0, -60.0]), 0.0, (60.0, 40.0), 1)
    for sight_m, depth, grey in ((150.0, 120.0, 110.0), (100.0, np.inf, 200.0)):
        renderer = Renderer(FORWARD, fly(FORWARD, Path(60.0)), Scene((wall,), 1, sight_m=sight_m), 1)
        assert renderer.view(Side.LEFT, MIDDLE_NS).depth_m(renderer.scene, np.array([[320.0, 240.0]]))[0] == depth
        image = renderer.render(Side.LEFT, INSTANT, 0)
        assert image[200:280, 280:360].mean() == pytest.approx(grey, abs=25.0)


def test_looking_at_the_sky_has_no_range() -> None:
    away = _with_cameras(NADIR, axes=("y", "x", "-z"))
    assert true_range_m(ground_scene(1), *_views(away, Path(50.0))) == np.inf


def test_boards_stand_across_the_path_one_after_another() -> None:
    truth = fly(FORWARD, Path(60.0, 100.0))
    scene = obstacle_scene(truth, 1, spacing_m=50.0)
    assert len(scene.planes) >= 1 + 4
    renderer = Renderer(FORWARD, truth, scene, 1)
    views = [renderer.view(side, 10_000_000) for side in Side]
    # the flight starts 100 m south of the origin; 1 m on, the first board is 49 m ahead
    assert true_range_m(scene, *views, TrueRangeProduct.CENTRE) == pytest.approx(49.0, abs=1.1)
