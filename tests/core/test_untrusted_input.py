"""Files and arguments of strangers: whatever they hold, the answer is a result or BadInput.

``make fuzz`` runs the same tests with many more inputs: the environment variable ``NRBENCH_FUZZ`` is their number for
each test.
"""

import atexit
import contextlib
import functools
import io
import json
import os
import shutil
import tempfile
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import PIL.Image
import PIL.ImageCms
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from label_files import write_answers

from nrbench import plugins, run
from nrbench.datasets_procedural.images import read_rendered, read_truth
from nrbench.errors import BadInput
from nrbench.labelling.labels import make_page, read_labels, write_key
from nrbench.lattice.geometry import Lattice
from nrbench.pictures.files import MOST_PIXELS, read_image, read_shape
from nrbench.plugins.parameters import parse_size, parse_spec
from nrbench.reports.page.pictures import PictureStore
from nrbench.running.runner import Options
from nrbench.runs.records import Run
from nrbench.suites.plan import LatticeSource, PlannedMethod
from nrbench.suites.suite import directory_suite, load_suite

INPUTS = int(os.environ.get("NRBENCH_FUZZ", "60"))
fuzz = settings(
    max_examples=INPUTS,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large, HealthCheck.function_scoped_fixture],
    derandomize="NRBENCH_FUZZ" not in os.environ,
)


def encoded(form: str, mode: str = "RGB", **options: Any) -> bytes:
    """Return a small picture in a format of files."""
    pixels = np.random.default_rng(0).integers(0, 255, (12, 17, 3)).astype(np.uint8)
    picture = PIL.Image.fromarray(pixels)
    picture = PIL.Image.fromarray(pixels[..., 0].astype(np.uint16) * 257) if mode == "I;16" else picture.convert(mode)
    target = io.BytesIO()
    picture.save(target, form, **options)
    return target.getvalue()


@contextlib.contextmanager
def files(**contents: bytes) -> Iterator[Path]:
    """Yield a temporary folder that holds two pictures, and files of other contents."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for file, content in {"a_png": pictures()[0], "b_png": pictures()[0], **contents}.items():
            (folder / file.replace("_", ".")).write_bytes(content)
        yield folder


@functools.cache
def pictures() -> list[bytes]:
    """Return pictures of many formats, with EXIF, transparency and several compressions."""
    exif = PIL.Image.Exif()
    exif[0x0112] = 6
    tiffs = [encoded("TIFF", compression=one) for one in ("raw", "tiff_lzw", "tiff_deflate", "packbits", "jpeg")]
    pngs = [encoded("PNG", mode) for mode in ("RGB", "L", "P", "RGBA", "LA", "1", "I;16")]
    jpegs = [encoded("JPEG", exif=exif.tobytes()), encoded("JPEG", "L", progressive=True), encoded("JPEG", "CMYK")]
    others = [encoded(form) for form in ("WEBP", "BMP", "GIF", "PPM", "TGA", "JPEG2000", "AVIF")]
    others.append(
        encoded("PNG", icc_profile=PIL.ImageCms.ImageCmsProfile(PIL.ImageCms.createProfile("sRGB")).tobytes())
    )
    return [*pngs, *jpegs, *tiffs, encoded("TIFF", "I;16"), *others]


@st.composite
def mutated(draw: st.DrawFn, originals: st.SearchStrategy[bytes]) -> bytes:
    """Return bytes in which some were replaced, inserted or cut off; half of the places lie in the first 64 bytes."""
    content = bytearray(draw(originals))
    for _ in range(draw(st.integers(0, 8))):
        last = max(0, (min(64, len(content)) if draw(st.booleans()) else len(content)) - 1)
        place = draw(st.integers(0, last))
        what = draw(st.sampled_from(("byte", "large", "insert", "cut", "double")))
        if what == "byte":
            content[place : place + 1] = bytes([draw(st.integers(0, 255))])
        elif what == "large":
            content[place : place + 4] = draw(st.sampled_from((b"\xff\xff\xff\xff", b"\x7f\xff\xff\xff", b"\0\0\0\0")))
        elif what == "insert":
            content[place:place] = draw(st.binary(max_size=9))
        elif what == "double":
            content[place:place] = content[place : place + draw(st.integers(0, 64))]
        else:
            del content[place : place + draw(st.integers(0, 64))]
    return bytes(content)


@fuzz
@given(mutated(st.sampled_from(range(24)).map(lambda i: pictures()[i % len(pictures())])))
def test_damaged_pictures(content: bytes) -> None:
    """A picture whose bytes were changed is read as an image in [0, 1], or is bad input."""
    with files(picture_png=content) as folder:
        for read in (read_shape, read_image):
            try:
                found: Any = read(folder / "picture.png")
            except BadInput as error:
                assert "picture.png" in str(error)
                continue
            if isinstance(found, tuple):
                assert min(found) >= 1
            else:
                assert found.dtype == np.float32 and found.ndim == 3 and found.shape[2] in (1, 3)
                assert np.isfinite(found).all() and 0 <= found.min() <= found.max() <= 1


def bomb(width: int, height: int) -> bytes:
    """Return a PNG of a few hundred bytes whose header promises a picture of this size."""
    content = bytearray(encoded("PNG"))
    content[16:24] = width.to_bytes(4, "big") + height.to_bytes(4, "big")
    content[29:33] = zlib.crc32(bytes(content[12:29])).to_bytes(4, "big")
    return bytes(content)


@pytest.mark.parametrize("size", [(10000, 10000), (60000, 60000), (2**31 - 1, 2**31 - 1), (8193, 8192)])
def test_bombs_are_refused_with_the_limit(size: tuple[int, int], tmp_path: Path) -> None:
    """A picture of 100 megapixels, or whose header claims more, is refused before it is decoded; the limit is named."""
    path = tmp_path / "bomb.png"
    path.write_bytes(bomb(*size))
    for read in (read_image, read_shape):
        with pytest.raises(BadInput, match=f"{MOST_PIXELS} px"):
            read(path)


SUITE = """
name = "mine"
version = 1
seed = 3
replicates = 2
sample = "64x64"
size = "96x80"
lattice = ["given", "gncc"]
methods = ["tiling", "rsgf:block=16"]
[[texture]]
name = "wall"
dataset = "brick"
parameters = { color = 0.2 }
[[grid]]
name = "{dataset}-{strength}"
axes = [[{ dataset = "brick" }, { dataset = "weave" }], [{ strength = "mild", parameters = { color = 0.1 } }]]
[[claim]]
name = "c"
sentence = "s"
methods = ["tiling"]
textures = ["wall"]
"""


@fuzz
@given(mutated(st.just(SUITE.encode())))
def test_damaged_suites(content: bytes) -> None:
    """A TOML file whose bytes were changed is a suite, with methods and lattices, or bad input."""
    with files(mine_toml=content) as folder:
        try:
            suite = load_suite(folder / "mine.toml")
            assert suite.hash
            for spec in suite.all_methods:
                PlannedMethod.parse(spec)
            for source in suite.lattice:
                LatticeSource.parse(source)
        except BadInput as error:
            assert str(error)


ODD = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=8), inner, max_size=3),
    max_leaves=6,
)
TRUTH = b"file,t1x,t1y,t2x,t2y,originx,originy,family\na.png,16,0,0,12,3,2,wall\nb.png,,,,,,,\n"
RENDERED = b"""{"sheet": "sheet.png", "textures": {"a.png": {"family": "wall", "level": 1.0, "recipe": {
"dataset": "brick", "parameters": {"color": 0.2}, "seed": 0, "texture": "wall", "replicate": 0, "shape": "64x64"}}}}"""


@fuzz
@given(mutated(st.just(TRUTH)), mutated(st.just(RENDERED)))
@example(b"file,t1x,t1y,t2x,t2y\na.png,1e999,0,0,nan\n", b"{}")
@example(b"file,t1x,t1y,t2x,t2y\na.png,1e308,1e308,1e308,-1e308\n", b"[" * 100000)
def test_damaged_truth(table: bytes, rendered: bytes) -> None:
    """A folder whose truth.csv and truth.json were changed is a suite of pictures or bad input."""
    with files(truth_csv=table, truth_json=rendered) as folder:
        for read in (read_truth, read_rendered, directory_suite):
            try:
                read(folder)
            except BadInput as error:
                assert str(folder) in str(error) or "truth" in str(error)


NUMBERS = (
    st.floats() | st.integers(-(10**400), 10**400) | st.sampled_from(("nan", "inf", "1e-320", "1_0", "\u0663", ""))
)


@fuzz
@given(st.text(max_size=30) | st.lists(NUMBERS, max_size=7).map(lambda parts: ",".join(map(str, parts))))
@example("1e154,0,0,1e154")
@example("1e-160,1e160,1e160,1e-160")
@example("16,0,1600000000000000,12")
def test_lattice_arguments(text: str) -> None:
    """Any text is a lattice that has a reduced basis, or is bad input."""
    try:
        found = Lattice.parse(text)
    except BadInput:
        return
    assert np.isfinite(found.reduced().matrix).all() and found.area > 0
    assert LatticeSource.parse(text).lattice == found


@fuzz
@given(st.text(max_size=30) | st.from_regex(r"\d{1,6}[xX×]\d{1,6}"))
@example("9" * 5000 + "x9")
@example("\u0661x\u0662")
def test_size_arguments(text: str) -> None:
    """Any text is a size within the limit, or is bad input."""
    try:
        height, width = parse_size(text)
    except BadInput:
        return
    assert 1 <= height <= 16384 and 1 <= width <= 16384


NAMED = [
    (kind, plugin.name, field)
    for kind in ("synthesizers", "detectors", "datasets", "reports")
    for plugin in plugins.inventory(kind)
    if plugin.built_in
    for field in plugin.cls.__dataclass_fields__
]


@fuzz
@given(st.sampled_from(NAMED), st.text(max_size=12) | NUMBERS.map(str))
def test_parameters_of_plugins(place: tuple[str, str, str], value: str) -> None:
    """Any text for any parameter of any plugin is a valid value or bad input."""
    kind, name, field = place
    try:
        plugins.build(kind, name, {field: value})
        parse_spec(f"{name}:{field}={value}")
    except BadInput as error:
        assert str(error)


@st.composite
def odd_json(draw: st.DrawFn, original: bytes) -> bytes:
    """Return a JSON file in which the value of one key was replaced by something odd."""
    content = json.loads(original)
    place = content
    while True:
        keys = list(place) if isinstance(place, dict) else list(range(len(place)))
        key = draw(st.sampled_from(keys))
        if not isinstance(place[key], dict | list) or not place[key] or draw(st.booleans()):
            place[key] = draw(ODD)
            return json.dumps(content).encode()
        place = place[key]


@functools.cache
def cell_files() -> tuple[Path, list[Path]]:
    """Return a run of one cell, with a page of labels and a source map, and the files that readers trust."""
    root = Path(tempfile.mkdtemp(prefix="fuzz-")) / "run"
    atexit.register(shutil.rmtree, root.parent, ignore_errors=True)
    words: dict[str, Any] = {"methods": "tiling", "textures": "brick-mild", "lattice": "given", "metrics": ["cost"]}
    made = run("core", out=root, options=Options(jobs=0), **words)
    page = make_page(made)
    write_key(root, page)
    answers = write_answers(root / "answers.csv", page, [["yes"] * len(page.questions)] * len(page.items))
    assert len(read_labels(made, [answers]))
    return root, sorted(file for file in root.rglob("*") if file.suffix in (".json", ".npz", ".png", ".csv"))


@fuzz
@given(st.data())
def test_damaged_files_of_a_cell(data: st.DataObject) -> None:
    """Whatever a file of a cell or a page of labels holds, the tables and a page of pictures are made, or bad input."""
    root, names = cell_files()
    path = data.draw(st.sampled_from(names))
    whole = path.read_bytes()
    odd = odd_json(whole) if path.suffix == ".json" else st.nothing()
    path.write_bytes(data.draw(odd | mutated(st.just(whole))))
    try:
        found = Run(root)
        for report in (found.ends, found.table, lambda: plugins.build("reports", "csv").tables(found)):
            report()
        store = PictureStore(root)
        store.load(path.parent / "output.png")
        store.source_map(path.parent / "source.npz")
        read_labels(found, [root / "answers.csv"])
    except BadInput as error:
        assert str(root) in str(error)
    finally:
        path.write_bytes(whole)
