"""Recorder of the README's animated picture: a live press on the page of `simgen view`, in a headless browser.

Run ``python docs/generate/live_press.py FILE.gif``. It needs selenium, chromium and chromedriver. Each frame stays as
long as the browser showed it, so the picture has the speed of the press.
"""

import base64
import io
import json
import re
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from itertools import pairwise
from pathlib import Path
from urllib.request import urlopen

from PIL import Image
from selenium import webdriver
from selenium.webdriver.common.action_chains import ActionChains
from selenium.webdriver.common.by import By
from selenium.webdriver.support.ui import WebDriverWait
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import ClientConnection, connect

SIZE = 1080, 705  # px, of the window
FLAGS = ("--headless=new", "--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader")
CLICKS = ((-30, -15), (60, 20))  # px from the middle of the view, one press after the other
HOLD_MS = 1500  # of the last frame of a press
LONGEST_S = 120
READY, SAID = ".panel .small.fill", ".said"


class Screencast:
    """Frames of a browser's page as its compositor makes them, and their times, s."""

    def __init__(self, socket: ClientConnection):
        self.frames: list[Image.Image] = []
        self.times: list[float] = []
        self._socket = socket
        self._send("Page.startScreencast", format="png", everyNthFrame=1)
        threading.Thread(target=self._listen, daemon=True).start()

    def _send(self, method: str, **parameters) -> None:
        self._socket.send(json.dumps({"id": 1, "method": method, "params": parameters}))

    def _listen(self) -> None:
        try:
            for text in self._socket:
                message = json.loads(text)
                if message.get("method") == "Page.screencastFrame":
                    frame = message["params"]
                    self._send("Page.screencastFrameAck", sessionId=frame["sessionId"])
                    with Image.open(io.BytesIO(base64.b64decode(frame["data"]))) as shot:
                        self.frames.append(shot.convert("RGB").crop((0, 0, *SIZE)))
                    self.times.append(frame["metadata"]["timestamp"])
        except ConnectionClosed:
            pass


def page_socket(debugger: str) -> str:
    """Address at which a browser takes commands for its page."""
    with urlopen(f"http://{debugger}/json") as answer:
        [page] = [each for each in json.load(answer) if each["type"] == "page"]
    return page["webSocketDebuggerUrl"]


def record(link: str) -> tuple[list[Image.Image], list[int]]:
    """Press at each of `CLICKS`; returns frames and their durations, ms."""
    options = webdriver.ChromeOptions()
    for flag in (*FLAGS, f"--window-size={SIZE[0]},{SIZE[1] + 140}"):
        options.add_argument(flag)
    options.binary_location = shutil.which("chromium") or ""
    with webdriver.Chrome(options, webdriver.ChromeService(shutil.which("chromedriver"))) as driver:
        driver.get(link)
        wait = WebDriverWait(driver, LONGEST_S)
        wait.until(lambda _: any("ready" in each.text for each in driver.find_elements(By.CSS_SELECTOR, READY)))
        canvas = driver.find_element(By.TAG_NAME, "canvas")
        debugger = driver.capabilities["goog:chromeOptions"]["debuggerAddress"]
        with connect(page_socket(debugger), max_size=None) as socket:
            cast = Screencast(socket)
            said = driver.find_element(By.CSS_SELECTOR, SAID)
            for across, down in CLICKS:
                before = said.text
                ActionChains(driver).move_to_element_with_offset(canvas, across, down).click().perform()
                wait.until(lambda _, before=before: " depths in " in said.text != before)
                time.sleep(HOLD_MS / 1000)
            frames, times = list(cast.frames), list(cast.times)
    durations = [round(1000 * (after - before)) for before, after in pairwise(times)]
    durations = [min(each, HOLD_MS) for each in durations[: len(frames) - 1]]
    return frames, [*durations, HOLD_MS]


def write_gif(frames: list[Image.Image], durations: list[int], file: Path) -> None:
    """Write frames with one palette."""
    some = Image.new("RGB", (SIZE[0], 3 * SIZE[1]))
    for i, frame in enumerate((frames[0], frames[len(frames) // 2], frames[-1])):
        some.paste(frame, (0, i * SIZE[1]))
    palette = some.quantize(256)
    first, *others = (frame.quantize(palette=palette, dither=Image.Dither.FLOYDSTEINBERG) for frame in frames)
    first.save(file, save_all=True, append_images=others, duration=durations, loop=0, optimize=True)


def main(file: Path) -> None:
    """Serve the page, record it and write the picture."""
    press = ["--sensor", "digit", "--indenter", "ring_7mm"]
    command = [sys.executable, "-m", "simgen.cli", "view", *press, "--no-browser"]
    with tempfile.TemporaryDirectory() as folder:
        server = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=folder)
        try:
            link = next(re.search(r"http://\S+", line)[0] for line in server.stdout if "http://" in line)
            write_gif(*record(link), file)
        finally:
            server.terminate()
            server.wait()
    print(f"wrote {file} ({file.stat().st_size / 1e6:.1f} MB)")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
