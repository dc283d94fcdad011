"""Take docs/images/view.png: the page of `urlink view` with a simulated arm that is pushed. Needs chromedriver."""

import argparse
import io
import shutil
import time
from pathlib import Path

from PIL import Image
from selenium import webdriver

import urlink


def main() -> None:
    """Open the page in a browser without a window, and save a screenshot."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--output", type=Path, default=Path(__file__).parent / "images" / "view.png")
    parser.add_argument("--address", default="sim://ur5e?motion=demo")
    parser.add_argument("--seconds", type=float, default=40.0, help="time to wait for the first image, s")
    args = parser.parse_args()
    options = webdriver.ChromeOptions()
    for option in ("headless=new", "no-sandbox", "enable-unsafe-swiftshader", "window-size=1180,800"):
        options.add_argument(f"--{option}")
    driver = webdriver.Chrome(options=options, service=webdriver.ChromeService(shutil.which("chromedriver")))
    try:
        with urlink.connect(args.address) as robot, robot.view(plots=["qd_actual"]) as view:
            if robot.controller is not None:
                robot.controller.push([0.0, 40.0, 60.0, 0.0, 0.0, 0.0])
            driver.get(view.address)
            time.sleep(args.seconds)
            # The missing graphics card does not matter.
            driver.execute_script("document.querySelectorAll('[class*=Notifications-root]').forEach(n => n.remove())")
            picture = Image.open(io.BytesIO(driver.get_screenshot_as_png()))
            # The octree keeps the colours of thin curves, which the median cut replaces by greys.
            few = picture.convert("RGB").quantize(256, method=Image.Quantize.FASTOCTREE)
            few.save(args.output, optimize=True)
    finally:
        driver.quit()


if __name__ == "__main__":
    main()
