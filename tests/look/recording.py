"""The recording in the headless viewer: a picture of every tab that is not empty."""

import os
import pathlib
import socket
import subprocess
import sys
import time

import rerun
import rerun_cli
from PIL import Image
from rerun.experimental import ViewerClient


def main():
    recording, out = map(pathlib.Path, sys.argv[1:])
    program = pathlib.Path(rerun_cli.__file__).with_name("rerun")
    subprocess.run([program, "rrd", "verify", recording], check=True)
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    environment = {**os.environ, "XDG_RUNTIME_DIR": os.environ.get("XDG_RUNTIME_DIR", "/tmp")}
    viewer = subprocess.Popen(
        [program, "--headless", "--bind", "127.0.0.1", "--port", str(port), "--hide-welcome-screen",
         "--window-size", "1600x1000", recording],
        env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        time.sleep(8)
        client = ViewerClient.connect(f"rerun+http://127.0.0.1:{port}/proxy")
        whole = out / "recording.png"
        client.save_screenshot(str(whole.resolve()))
        check(whole, 200)
        # Views have fixed numbers, in the order of the layout.
        seen = 0
        for number in range(1, int(os.environ.get("VIEWS", "25"))):
            picture = out / f"recording_view_{number:02}.png"
            try:
                client.save_screenshot(str(picture.resolve()), view_id=f"00000000-0000-0000-0000-{number:012x}")
            except Exception:  # A container, or a view behind another tab.
                continue
            if picture.exists():
                check(picture, 8)
                seen += 1
        assert seen >= 5, f"only {seen} views could be seen"
        print(f"the recording: {seen} views")
    finally:
        viewer.terminate()
        viewer.wait(30)


def check(picture, least):
    for _ in range(50):
        if picture.exists() and picture.stat().st_size > 0:
            break
        time.sleep(0.1)
    colors = Image.open(picture).convert("RGB").getcolors(1 << 24)
    assert len(colors) >= least, f"{picture} is empty: {len(colors)} colours"


assert rerun.__version__ == "0.36.3", rerun.__version__
main()
