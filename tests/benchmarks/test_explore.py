"""The page of `eyespot explore`: its numbers, its drawings, and its sliders in Chromium."""

import math
import re
import time
from urllib.parse import parse_qs, urlsplit

import jax.numpy as jnp
import numpy as np
import pytest

import eyespot
from eyespot.benchmarks import explore
from eyespot.formats.inputs import InputError
from tests.support.browser import browser, console, wait_until

__all__ = ["browser"]  # a fixture
STATE = explore.state_of({"c": "2.0", "d": "3", "tilt": "20", "azimuth": "90", "height": "175"})


def test_the_page_shows_what_the_function_computes():
    errors = eyespot.model_error(
        height=175.0,
        eye_radius=11.5,
        na=0.12,
        core_radius=0.1,
        medium="air",
        changes={
            "workspace.eccentricity_mm": [2.0, 2.0],
            "workspace.distance_mm": [3.0, 3.0],
            "workspace.tilt_deg": [20.0, 20.0],
            "workspace.azimuth_deg": [90.0, 90.0],
        },
    )
    shown = explore.drawing(STATE)["table"]
    for model, own in errors.groupby("model"):
        assert f"{own.estimate_mm.iloc[0]:.3f}</td>" in shown, model


def test_the_image_has_the_contour_of_optics():
    from eyespot import optics

    wall = optics.Sphere(11.5)
    view = optics.microscope(scale=0.0067, pinhole_height=175.0, eye_radius=11.5)
    half_angle = math.asin(0.12)
    beam = optics.beam_at_spot(
        wall,
        eccentricity=2.0,
        distance=3.0,
        incidence=math.radians(20.0),
        incidence_azimuth=math.pi / 2,
        half_angle=half_angle,
        apex_offset=-0.1 / math.tan(half_angle),
    )
    contour = np.asarray(optics.spot_contour(beam, wall, view))
    corners = re.findall(r'points="([^"]*)"', explore.drawing(STATE)["image"])[0].split()
    drawn = np.array([[float(x) for x in corner.split(",")] for corner in corners])
    # The drawing has five digits: 0.005 px at 400 px.
    assert drawn.min(axis=0) == pytest.approx(contour.min(axis=0), abs=0.3)
    assert drawn.max(axis=0) == pytest.approx(contour.max(axis=0), abs=0.3)
    # Each of its points lies between two of the 128 of optics, 3.6 px apart, on the same curve.
    ellipse = optics.ellipse_of_contour(jnp.asarray(contour))
    apart = np.hypot(*(drawn - np.asarray(ellipse.centre)).T)
    assert apart.min() >= float(ellipse.semi_minor) - 0.3
    assert apart.max() <= float(ellipse.semi_major) + 0.3


def test_an_address_keeps_the_state_and_cannot_break_it():
    query = {name: f"{value}" for name, value in STATE.items()}
    assert explore.state_of(query) == STATE
    wrong = explore.state_of({"c": "nan", "d": "far", "source": "<svg>", "tilt": "1e9", "x": "1"})
    assert wrong == explore.state_of({"tilt": "60"})


def test_ten_images_a_second():
    """A drawing takes a tenth of that here; the rest is for a machine that is busy."""
    explore.drawing(STATE)
    start = time.process_time()
    for step in range(10):
        explore.drawing({**STATE, "c": 2.0 + 0.1 * step})
    assert time.process_time() - start < 1.0


def test_what_cannot_be_is_said_on_the_page():
    with pytest.raises(InputError, match="distance_mm must lie below 8 mm"):
        explore.drawing({**STATE, "radius": 4.0, "d": 10.0})


@pytest.mark.slow
def test_sliders_move_the_numbers_and_the_address(browser, tmp_path):
    words = "eyespot", "explore", "--port", "{port}"
    with console(*words, log=tmp_path / "log") as address:
        for width in (1280, 390):
            page = browser.new_page(viewport={"width": width, "height": 844})
            page.goto(f"{address}?c=3&d=3&tilt=20&azimuth=0&height=175")
            page.wait_for_selector("svg[aria-label='Error against eccentricity']")
            slider = page.locator(".turns-c")
            slider.click(position={"x": 0.7 * slider.bounding_box()["width"], "y": 8})
            wait_until(lambda: "c=3&" not in page.evaluate("location.href"), "the address")  # noqa: B023
            query = parse_qs(urlsplit(page.evaluate("location.href")).query)
            state = explore.state_of({name: values[0] for name, values in query.items()})
            assert state["c"] == pytest.approx(7.0, abs=0.3)  # 12 px of a track of 200
            time.sleep(0.5)  # ten times the page's own period
            errors = re.findall(r"[+-][0-9.]+", page.locator("table").inner_text())
            drawn = re.findall(r">([+-][0-9.]+)<", explore.drawing(state)["table"])
            assert errors == drawn
            # No sideways scrolling.
            assert page.evaluate("document.documentElement.scrollWidth") <= width
            page.close()
