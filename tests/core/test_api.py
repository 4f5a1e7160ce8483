"""The Python functions: what they accept as a lattice and as images, and the words for errors."""

import io
from typing import Any

import numpy as np
import PIL.Image
import pytest

import nrbench
from nrbench.api.arguments import as_lattice, lattice_source_texts
from nrbench.api.textures import score
from nrbench.errors import BadInput, strip_control
from nrbench.lattice.geometry import Lattice


def test_a_lattice_may_be_given_in_any_form() -> None:
    """Vectors, vectors with an origin, their numbers, text and a lattice give the same lattice; None gives none."""
    lattice = Lattice((27.3, 0), (13.65, 12.2), (3, 4))
    vectors = ((27.3, 0), (13.65, 12.2), (3, 4))
    assert as_lattice(lattice) == as_lattice(vectors) == as_lattice("27.3,0,13.65,12.2,3,4") == lattice
    assert as_lattice(vectors[:2]) == as_lattice("27.3,0,13.65,12.2")
    assert as_lattice((27.3, 0, 13.65, 12.2)) == as_lattice(vectors[:2])
    assert as_lattice(np.ravel(vectors)) == lattice and as_lattice(None) is None


def test_the_lattice_axis_takes_every_form_too() -> None:
    """Numbers, vectors and arrays are one entry; a list of lattices, of texts or of both is several."""
    vectors = ((27.3, 0.0), (13.65, 12.2))
    flat = (27.3, 0.0, 13.65, 12.2)
    text = "27.3,0.0,13.65,12.2"
    forms = (
        flat,
        list(flat),
        vectors,
        list(map(list, vectors)),
        np.array(flat),
        np.array(vectors),
        np.array([flat])[0],
    )
    for form in (*forms, tuple(map(np.array, vectors)), Lattice(*vectors)):
        assert lattice_source_texts(form)[0].startswith(text) and len(lattice_source_texts(form)) == 1
    assert lattice_source_texts(["own", flat]) == ["own", text] and lattice_source_texts([flat, vectors]) == [text] * 2
    assert lattice_source_texts("given") == ["given"] and lattice_source_texts(["given"]) == ["given"]
    assert lattice_source_texts(()) == []
    with pytest.raises(BadInput, match="lattice 27: give two vectors"):
        lattice_source_texts([27, "own"])


def test_an_origin_of_zero_is_known() -> None:
    """Given as (0, 0), the origin becomes another point of the lattice; without an origin it stays (0, 0), unknown."""
    given: Any
    for given in ("28,0,14,12,0,0", ((28, 0), (14, 12), (0, 0)), (28, 0, 14, 12, 0, 0)):
        made = as_lattice(given)
        assert made is not None and made.origin == (28, 0)
    assert as_lattice("28,0,14,12").origin == (0, 0)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (((32, 0),), r"lattice \(\(32, 0\),\): give two vectors"),
        ((32, 0, 0, 24, 1), "give two vectors"),
        (32, "lattice 32: give two vectors"),
        ((32, 24), r"lattice \(32, 24\): give two vectors"),
        (((1.5, 0), (0, 24)), "repeats every 1.5 px"),
        (Lattice((1.5, 0), (0, 24)), "repeats every 1.5 px"),
        ("1.5,0,0,24", "lattice '1.5,0,0,24': repeats every 1.5 px"),
    ],
)
def test_what_is_no_lattice_is_refused(given: Any, message: str) -> None:
    """The error shows what was given and says what to give."""
    with pytest.raises(BadInput, match=message):
        as_lattice(given)


@pytest.mark.parametrize("sample_form", ["gray", "alpha", "color"])
@pytest.mark.parametrize("output_form", ["gray", "alpha", "color"])
def test_score_takes_gray_in_any_form(monkeypatch: pytest.MonkeyPatch, sample_form: str, output_form: str) -> None:
    """A gray picture may be stored with opaque alpha or in color: metrics see both images with the same channels."""
    monkeypatch.setattr("nrbench.api.textures.score_observation_by", lambda observation, *rest: observation)
    plane = np.random.default_rng(0).integers(0, 256, (16, 20), np.uint8)
    forms = {"gray": plane, "alpha": np.dstack([plane, plane * 0 + 255]), "color": np.dstack([plane] * 3)}
    seen: Any = score(forms[sample_form], forms[output_form])
    channels = 3 if sample_form == output_form == "color" else 1
    assert seen.sample.shape == seen.output.shape == (16, 20, channels)
    np.testing.assert_array_equal(seen.sample, seen.output)


def test_score_refuses_color_beside_gray() -> None:
    """A picture in color is not compared with a gray one."""
    plane = np.random.default_rng(0).integers(0, 256, (16, 20), np.uint8)
    with pytest.raises(BadInput, match="has 3 channels, the sample 1"):
        score(plane, np.dstack([plane, plane, 255 - plane]))


def test_control_characters_are_dropped_and_lines_stay() -> None:
    """Terminal colors, bells and NUL are removed; line breaks and tabs stay."""
    assert strip_control("\x1b[1;31mred\x1b[0m\x00\x07\r\n\tb") == "red\n\tb"


def test_python_knows_the_words_of_the_command_line() -> None:
    """A method with parameters, a size and a detector as text give what keywords, a shape and the lattice give."""
    brick = nrbench.texture("brick:color=0.3", "96x64", seed=1)
    assert np.array_equal(brick.image, nrbench.texture("brick", (64, 96), seed=1, color=0.3).image)
    found = nrbench.detect_lattice(brick, "dominance:reject=none").lattice
    by_text = nrbench.synthesize("rsgf:block=24", brick, "80x72", lattice="dominance:reject=none")
    by_words = nrbench.synthesize("rsgf", brick, (72, 80), lattice=found, block=24)
    assert np.array_equal(by_text.image, by_words.image)
    assert {name.partition(".")[0] for name in nrbench.score(brick, by_text, metrics="cost,source").values} == {
        "cost",
        "source",
    }
    with pytest.raises(nrbench.BadInput, match="lattice 'consensu': give x1,y1,x2,y2 in px, or a detector"):
        nrbench.synthesize("rsgf", brick, "80x72", lattice="consensu")


def test_notebooks_show_the_picture_of_an_image() -> None:
    """The PNG of a texture and of a gray synthesis has their pixels, and their texts hold no arrays."""
    brick = nrbench.texture("brick", (40, 48))
    gray = nrbench.Synthesis(nrbench.gray(brick.image))
    for shown, mode in ((brick, "RGB"), (gray, "L")):
        with PIL.Image.open(io.BytesIO(shown._repr_png_())) as picture:
            assert picture.mode == mode
            assert np.abs(np.asarray(picture) / 255 - np.squeeze(shown.image)).max() <= 0.501 / 255
        assert "array(" not in repr(shown)
