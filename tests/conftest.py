"""Browser for the tests of pages, and rays as another processor would cast them.

`TEST_RAY_JITTER=1e-7 pytest` moves every ray by about one unit in the last place, as another instruction set does: rays
at an edge then hit what lies beside it. The suite must pass with and without.
"""

import os
import shutil

import numpy as np
import pytest

BROWSERS = ("chromium", "chromium-browser", "google-chrome")
FLAGS = ("--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader")


@pytest.fixture(scope="module")
def browser():
    from playwright.sync_api import sync_playwright

    path = next(filter(None, map(shutil.which, BROWSERS)), None)
    if path is None:
        pytest.fail("pages are tested in Chromium, which is not here: run make, or apt-get install chromium")
    with sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=path, args=list(FLAGS))
        yield chromium
        chromium.close()


@pytest.fixture(scope="session", autouse=True)
def ray_jitter():
    """Perturb all rays by a fixed function of themselves, so that equal rays stay equal."""
    share = float(os.environ.get("TEST_RAY_JITTER", 0))
    if not share:
        yield
        return
    import open3d as o3d

    def jitter(cast):
        def cast_jittered(scene, rays, *args, **options):
            lines = np.array(rays.numpy() if hasattr(rays, "numpy") else rays, np.float32)
            phase = lines.astype(np.float64) @ np.array([311.7, 127.1, 269.5, 1833.3, 2461.9, 1139.1])
            lines[..., 3:] *= 1 + share * np.sin(phase[..., None] + np.arange(3))
            return cast(scene, o3d.core.Tensor(lines), *args, **options)

        return cast_jittered

    with pytest.MonkeyPatch.context() as patch:
        for name in ("cast_rays", "test_occlusions"):
            scene = o3d.t.geometry.RaycastingScene
            patch.setattr(scene, name, jitter(getattr(scene, name)))
        yield
