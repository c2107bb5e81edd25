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
        # Views have fixed numbers, in the order of the layout; the viewer never answers for one that is not on show.
        for number in [1, 2, 3]:
            picture = out / f"recording_view_{number:02}.png"
            client.save_screenshot(str(picture.resolve()), view_id=f"00000000-0000-0000-0000-{number:012x}")
            check(picture, 8)
        print(f"the recording: {whole} and three of its views")
    finally:
        viewer.terminate()
        viewer.wait(30)


def check(picture, least):
    colors = []
    for _ in range(50):
        try:
            colors = Image.open(picture).convert("RGB").getcolors(1 << 24)
            break
        except OSError:  # The viewer is still writing it.
            time.sleep(0.2)
    assert len(colors) >= least, f"{picture} is empty: {len(colors)} colours"


assert rerun.__version__ == "0.36.3", rerun.__version__
main()
