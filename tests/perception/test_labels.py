"""Labels by counting stained pixels, beside what was drawn on the cups."""

import json
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scores import matched

from drawn_tables import Can, boxes_cloud, draw
from halfseen.errors import ArgumentError, CloudError
from halfseen.perception import Cloud, Label, LabelFile, Labeller, StainCounter, perceive, read_cloud, read_labels
from halfseen.perception.labels import share_in_view
from halfseen.perception.solids import Hull
from halfseen.perception.view import HIGHEST_M, LOWEST_M, other_things, other_things_in_words
from halfseen.scene import Stain, Surface, capture, draw_surface, random_table, read_table, table_paths
from halfseen.scene.cups import SURFACES
from halfseen.scene.record import colours, is_within
from halfseen.scene.view import table_view
from halfseen.world.seeing import AssumedSeeing
from refusals import refused

# Tables that neither the counter nor perception was tried on.
FRESH_SEEDS = range(61_000, 61_005)
LAW = AssumedSeeing()
BASELINE_M = 0.075


@pytest.fixture(scope="module")
def table():
    return read_table(5)


@pytest.fixture(scope="module")
def surfaces(table):
    rng = np.random.default_rng(0)
    return [draw_surface(cup, is_dirty, rng) for cup, is_dirty in zip(table.cups, [True, False] * 4, strict=False)]


@pytest.fixture(scope="module")
def seen(table, surfaces):
    picture = capture(table, 1, surfaces=surfaces)
    return picture, perceive(picture.cloud)


@pytest.fixture(scope="module")
def ideal(table):
    return table_view(table, BASELINE_M)


def painted_as(surfaces, table, ideal, picture, seed):
    """The cloud of a picture with other walls of its cups, and noise of the colours of a seed."""
    seen_now = colours(ideal, table.camera, surfaces, table.world_from_cup, np.random.default_rng(seed))
    return replace(picture.cloud, colours=seen_now.reshape(-1, 3))


@pytest.fixture(scope="module")
def labelled(table, ideal, seen):
    """Gives the labels of the cups with other surfaces, or noise of another seed, in the same view."""
    picture, view = seen

    def label(surfaces, seed=1):
        return StainCounter()(view, painted_as(surfaces, table, ideal, picture, seed))

    return label


def num_painted(table, ideal, seen_object, cup, discs) -> int:
    """Pixels of an object at which geometry has one of the discs of a cup, in the ideal view of the table."""
    rays = table.camera.pixel_rays() * ideal.depth_m[..., None]
    points_m = table.camera.world_from_camera.apply(rays.reshape(-1, 3)[seen_object.pixels])
    own_m = table.world_from_cup[cup].apply_inverse(points_m)
    is_painted = np.zeros(len(own_m), dtype=bool)
    for disc in discs:
        is_painted |= is_within(disc, table.cups[cup], own_m)
    return int((is_painted & (ideal.labels.ravel()[seen_object.pixels] == cup)).sum())


@pytest.mark.parametrize("glaze", SURFACES.glazes)
@pytest.mark.parametrize("stain", SURFACES.stain_colours)
def test_stains_are_reported_from_every_glaze_in_light_and_shade(glaze, stain):
    rng = np.random.default_rng(0)
    light = rng.uniform(0.6, 1.0, size=(2000, 1))
    is_stained = np.arange(2000) < 100
    colours = np.where(is_stained[:, None], stain, glaze) * light + rng.normal(0, 4.0, (2000, 3))
    result = StainCounter().is_stained(np.clip(np.rint(colours), 0, 255).astype(np.uint8))
    # Cocoa is no darker than a red glaze: in the light, half of it is not seen.
    assert result[is_stained].mean() > (0.4 if (glaze, stain) == ((175, 60, 55), (124, 84, 44)) else 0.8)
    assert result[~is_stained].sum() <= 2


@pytest.mark.slow
def test_stained_pixels_are_counted_as_geometry_has_them(table, surfaces, ideal, seen):
    picture, view = seen
    labels, pairs = StainCounter()(view, picture.cloud), matched(view, picture.truth)
    assert len(pairs) == len(labels) == 5
    counts = []
    for cup, k in pairs:
        discs = (*surfaces[cup].stains, *surfaces[cup].spots)
        expected = num_painted(table, ideal, view.objects[k], cup, discs)
        counts.append(expected)
        assert labels[k].num_stained_px == pytest.approx(expected, abs=2 + 0.12 * expected)
        assert labels[k].num_seen_px == len(view.objects[k].pixels)
    assert max(counts) > 50


@pytest.mark.slow
def test_a_label_is_dirty_from_the_fewest_stained_pixels_on_and_a_share_in_view_falls_with_occlusion(seen):
    picture, view = seen
    labels = StainCounter()(view, picture.cloud)
    most = max(label.num_stained_px for label in labels)
    dirty = [StainCounter(fewest_px=fewest)(view, picture.cloud) for fewest in (most, most + 1)]
    assert [sum(label.is_dirty is True for label in labels) for labels in dirty] == [1, 0]
    shares = np.array([label.share_in_view for label in labels])
    order = np.argsort([seen.occlusion for seen in view.objects])
    assert (np.diff(shares[order]) <= 0).all()
    assert 0 < min(shares) < max(shares) <= 0.3
    with pytest.raises(CloudError, match=r"no colour.*labels in a file"):
        StainCounter()(view, replace(picture.cloud, colours=None))


def test_the_same_view_gives_the_same_labels_but_for_noise(surfaces, labelled):
    for labels in zip(*(labelled(surfaces, seed) for seed in (1, 2, 3)), strict=True):
        counts = np.array([label.num_stained_px for label in labels])
        assert np.ptp(counts) <= 3 + 0.1 * counts.max()
        if abs(counts.mean() - StainCounter.fewest_px) > 5:
            assert len({label.is_dirty for label in labels}) == 1


def test_in_the_dark_no_cup_is_called_clean(seen):
    """A sixteenth of the light leaves hues to noise: stains were missed, and their cups called clean."""
    picture, view = seen
    for share, known in ((0.5, {True, False}), (0.06, {None})):
        dark = replace(picture.cloud, colours=(picture.cloud.colours * share).astype(np.uint8))
        assert {label.is_dirty for label in StainCounter()(view, dark)} == known


def num_stained_at(view, cloud) -> dict:
    """Stained pixels of each object, by where it stands."""
    labels = StainCounter()(view, cloud)
    places = [tuple(np.round(seen.centroid_m, 1).tolist()) for seen in view.objects]
    return {place: label.num_stained_px for place, label in zip(places, labels, strict=True)}


def test_a_cloud_out_of_order_is_labelled_alike(surfaces, seen):
    picture, view = seen
    loose = Cloud(picture.cloud.points_m, colours=picture.cloud.colours)
    again = perceive(loose)
    assert again.image.is_virtual
    # Its pixels are 1.3 times as wide: an object has as many of them stained, less that square.
    here, there = num_stained_at(view, picture.cloud), num_stained_at(again, loose)
    assert here.keys() == there.keys()
    for place, count in here.items():
        assert there[place] == pytest.approx(count / 1.3**2, abs=3 + 0.15 * count)


def test_stains_that_wide_pixels_cannot_show_leave_the_label_unknown(seen):
    """A fifth of the points have pixels more than twice as wide; stains of a few were missed, and their cups clean."""
    picture, _ = seen
    returns = np.flatnonzero(np.isfinite(picture.cloud.points_m[:, 2]))
    some = np.random.default_rng(0).permutation(returns)[::5]
    thin = Cloud(picture.cloud.points_m[some], colours=picture.cloud.colours[some])
    view = perceive(thin)
    assert {label.is_dirty for label in StainCounter()(view, thin)} == {None}
    assert {label.is_dirty for label in StainCounter(widest_m=0.02)(view, thin)} >= {False}


@cache
def fresh(seed):
    """A table, the ideal view of it, a picture of white cups and what is perceived: each takes long."""
    table = random_table(seed)
    picture = capture(table, seed, surfaces=[Surface(cup, (238, 236, 230)) for cup in table.cups])
    return table, table_view(table, BASELINE_M), picture, perceive(picture.cloud)


@pytest.mark.slow
def test_sensitivity_and_false_alarms_on_random_tables(capsys):
    rows = []
    for seed in FRESH_SEEDS:
        (table, ideal, picture, view), rng = fresh(seed), np.random.default_rng(seed)
        for _ in range(4):
            surfaces = [draw_surface(cup, bool(rng.random() < 0.6), rng) for cup in table.cups]
            labels = StainCounter()(view, painted_as(surfaces, table, ideal, picture, seed))
            for cup, k in matched(view, picture.truth):
                painted = num_painted(table, ideal, view.objects[k], cup, (*surfaces[cup].stains, *surfaces[cup].spots))
                rows.append((view.objects[k].occlusion, surfaces[cup].is_dirty, labels[k].is_dirty, painted >= 12))
    occlusion, is_dirty, result, by_geometry = np.array(rows, dtype=float).T
    is_dirty, result, by_geometry = is_dirty == 1, result == 1, by_geometry == 1
    with capsys.disabled():
        print("\nocclusion    cups  sensitivity  specificity  right  right by the assumed law")
        for low, high in ((0, 0.05), (0.05, 0.3), (0.3, 0.6), (0.6, 1.0)):
            among = (occlusion >= low) & (occlusion < high)
            print(
                f"{low:.2f}-{high:.2f}  {among.sum():7d}  {result[among & is_dirty].mean():11.2f}  "
                f"{1 - result[among & ~is_dirty].mean():11.2f}  {(result == is_dirty)[among].mean():5.2f}  "
                f"{LAW.accuracy(occlusion[among]).mean():.2f}"
            )
        print(
            f"as many stained pixels as geometry has: {(result == by_geometry).mean():.3f} of {len(result)} labels "
            "agree"
        )
    assert (result == by_geometry).mean() > 0.95
    in_view = occlusion < 0.05
    assert 0.4 < result[in_view & is_dirty].mean() < 0.75
    assert 0.0 < result[~is_dirty].mean() < 0.15
    assert result[is_dirty & (occlusion > 0.3)].mean() < result[is_dirty & in_view].mean()


@pytest.mark.slow
def test_the_share_in_view_is_what_geometry_has_in_the_mean(capsys):
    true, result = [], []
    for seed in FRESH_SEEDS:
        table, ideal, picture, view = fresh(seed)
        labels = StainCounter()(view, picture.cloud)
        for cup, k in matched(view, picture.truth):
            true.append(share_of_walls(table, ideal, cup))
            result.append(labels[k].share_in_view)
    error = np.subtract(result, true)
    mean, absolute = error.mean(), abs(error).mean()
    with capsys.disabled():
        print(f"\nshare in view of {len(error)} cups: mean error {mean:+.3f}, absolute {absolute:.3f}")
    assert abs(mean) < 0.02
    assert absolute < 0.06
    assert np.corrcoef(result, true)[0, 1] > 0.8


def share_of_walls(table, ideal, index) -> float:
    """Share of a cup's walls, by area, whose points the ideal camera sees."""
    cup, pose = table.cups[index], table.world_from_cup[index]
    eye_m = pose.apply_inverse(np.array([table.camera.world_from_camera.position_m]))[0]
    whole, in_view = 0.0, 0.0
    for is_inside in (False, True):
        z, phi = np.meshgrid(np.linspace(0.01, 0.99, 50) * cup.height_m, np.linspace(-np.pi, np.pi, 100)[:-1])
        radius = cup.base_radius_m + (cup.rim_radius_m - cup.base_radius_m) * z / cup.height_m - cup.wall_m * is_inside
        across = np.stack([np.cos(phi), np.sin(phi), np.zeros_like(phi)], axis=-1).reshape(-1, 3)
        points_m = across * radius.reshape(-1, 1) + np.stack([0 * z, 0 * z, z], axis=-1).reshape(-1, 3)
        world_m = pose.apply(points_m)
        column, row = np.rint(table.camera.project(world_m)).astype(int).T
        depth_m = table.camera.world_from_camera.apply_inverse(world_m)[:, 2]
        faces = ((eye_m - points_m) * across).sum(axis=1) * (-1 if is_inside else 1) > 0
        meets = (ideal.labels[row, column] == index) & (abs(ideal.depth_m[row, column] - depth_m) < 0.006)
        whole, in_view = whole + radius.sum(), in_view + radius.ravel()[faces & meets].sum()
    return in_view / whole


def test_a_stain_on_the_far_side_is_not_seen(table, labelled):
    result = []
    for angle_rad in (-np.pi, -np.pi / 2, 0.0, np.pi / 2):
        discs = [Stain(angle_rad, 0.5 * cup.height_m, 0.012, False, (98, 62, 30)) for cup in table.cups]
        walls = [Surface(cup, (238, 236, 230), (disc,)) for cup, disc in zip(table.cups, discs, strict=True)]
        result.append([label.is_dirty for label in labelled(walls)])
    share = np.mean(result, axis=0)
    assert ((share > 0) & (share < 1)).all()


def test_one_colour_in_any_light_has_no_stain():
    light = np.linspace(0.3, 1.0, 500)[:, None]
    for glaze in (*SURFACES.glazes, *SURFACES.stain_colours):
        assert not StainCounter().is_stained(np.rint(light * glaze).astype(np.uint8)).any()


@pytest.mark.parametrize(
    "of", [lambda colours: colours.mean(axis=1), lambda _: 0, lambda _: 255], ids=["grey", "0", "255"]
)
def test_a_picture_without_colour_tells_nothing(seen, of):
    picture, view = seen
    colours = np.zeros_like(picture.cloud.colours)
    colours.T[:] = of(picture.cloud.colours)
    labels = StainCounter()(view, replace(picture.cloud, colours=colours))
    assert {label.is_dirty for label in labels} == {None}


ROWS = [{"object": 2, "label": "unknown"}, {"object": 0, "label": "dirty", "share_in_view": 0.25}]
ROWS += [{"object": 1, "label": "clean"}]
TOLD = (Label(True, 0.25), Label(False), Label(None))


def test_csv_and_json_say_the_same(tmp_path):
    (tmp_path / "a.csv").write_text("\ufefflabel, object, share_in_view\nunknown,2,\ndirty,0,0.25\n\nclean,1,\n")
    (tmp_path / "a.json").write_text(json.dumps(ROWS))
    assert read_labels(tmp_path / "a.csv", 3) == read_labels(tmp_path / "a.json", 3) == TOLD


def test_the_share_in_view_is_that_of_the_view_unless_the_file_says(tmp_path):
    drawn = draw(Can(-0.15, 0.0), Can(0.15, 0.0), Can(0.0, 0.1))
    view = perceive(drawn.cloud)
    assert len(view.objects) == 3
    (tmp_path / "a.json").write_text(json.dumps(ROWS))
    labeller = LabelFile(tmp_path / "a.json")
    assert isinstance(labeller, Labeller)
    labels = labeller(view, drawn.cloud)
    assert [label.word for label in labels] == ["dirty", "clean", "unknown"]
    assert [label.share_in_view for label in labels] == [0.25, *(share_in_view(seen) for seen in view.objects[1:])]


BAD = {
    "word": ("a.csv", "object,label\n0,filthy\n1,clean\n", "row 1: label is 'filthy'; give dirty, clean, unknown"),
    "empty word": ("a.csv", "object,label\n0,\n1,clean\n", "row 1: label is ''"),
    "word of another kind": ("a.json", '[{"object": 0, "label": ["dirty"]}]', r"row 1: label is \['dirty'\]"),
    "missing": ("a.csv", "object,label\n0,dirty\n", "object 1 of 2 has no label"),
    "twice": ("a.csv", "object,label\n0,dirty\n0,clean\n", "row 2: object 0 has a label already"),
    "too many": ("a.csv", "object,label\n0,dirty\n1,clean\n2,clean\n", "row 3: object is '2', but the view has"),
    "negative": ("a.json", '[{"object": -1, "label": "dirty"}]', "row 1: object is -1"),
    "no number": ("a.csv", "object,label\nmug,dirty\n", "row 1: object is 'mug'"),
    "true": ("a.json", '[{"object": true, "label": "dirty"}]', "row 1: object is True"),
    "share": ("a.csv", "object,label,share_in_view\n0,dirty,1.5\n", "row 1: share_in_view is '1.5'"),
    "share as text": ("a.json", '[{"object": 0, "label": "dirty", "share_in_view": "all"}]', "share_in_view is 'all'"),
    "share of another kind": ("a.json", '[{"object": 0, "label": "dirty", "share_in_view": []}]', "share_in_view is"),
    "no head": ("a.csv", "0,dirty\n1,clean\n", "row 1 has 0, dirty; give object, label"),
    "no label": ("a.csv", "object\n0\n", "row 1 has object; give object, label"),
    "more columns": ("a.csv", "object,label,colour\n0,dirty,red\n", "row 1 has object, label, colour"),
    "ragged": ("a.csv", "object,label\n0,dirty,1\n", "row 1 has 3 cells, and the first line 2"),
    "empty": ("a.csv", "", "object 0 of 2 has no label"),
    "no list": ("a.json", '{"object": 0, "label": "dirty"}', "it is not a list of objects"),
    "not valid JSON": ("a.json", "{", "it cannot be read as labels"),
    "binary": ("a.csv", b"\xff\xfe\x00", "it cannot be read as labels"),
    "suffix": ("a.txt", "object,label\n0,dirty\n", r"labels must be a \.csv or \.json file"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_files_are_refused_in_one_line(tmp_path, case):
    name, content, message = BAD[case]
    (tmp_path / name).write_bytes(content if isinstance(content, bytes) else content.encode())
    with refused(message, ArgumentError) as caught:
        read_labels(tmp_path / name, 2)
    assert name in str(caught.value)


@pytest.fixture(scope="module")
def cups():
    return perceive(read_cloud(table_paths()[7]))


def changed(view, hulls=(), heights_m=()):
    """The view with some objects of another kind, by number: hulls, or of other heights."""
    solids, heights = dict.fromkeys(hulls, Hull(np.eye(3))), dict(heights_m)
    return replace(
        view,
        objects=tuple(
            replace(seen, solid=solids.get(seen.id, seen.solid), height_m=heights.get(seen.id, seen.height_m))
            for seen in view.objects
        ),
    )


def test_boxes_and_heights_that_no_cup_has_are_no_cups_and_one_shape_may_be_two_cups_taken_for_one(cups):
    view = perceive(boxes_cloud())
    assert len(view.objects) == 2
    assert other_things(view) == (0, 1)
    assert other_things_in_words(view) == (
        "this is not a table of cups, and nothing was learned about other objects: 0 does not have the shape of a "
        "vessel; 1 does not have the shape of a vessel"
    )
    assert other_things(changed(cups, heights_m=[(2, HIGHEST_M + 0.01)])) == (2,)
    assert other_things_in_words(changed(cups, heights_m=[(0, LOWEST_M - 0.01)])) == (
        "not all on this table are cups, and nothing was learned about other objects: 0 is 0.035 m high (a cup "
        "0.045 to 0.17)"
    )
    assert other_things(changed(cups, [3])) == ()
    assert other_things(changed(cups, [3, 4])) == (3, 4)
    assert other_things(changed(cups, [3], [(4, 0.3)])) == (3, 4)
