"""The recording in the headless viewer: a picture of every tab that is not empty and shows the views it should."""

import os
import pathlib
import re
import socket
import subprocess
import sys
import time

import rerun
import rerun.blueprint
import rerun_cli
from PIL import Image
from rerun.experimental import RrdReader, ViewerClient, send_chunks


class Layout(rerun.blueprint.Blueprint):
    """The recording's own layout; `tab` lets every tabbed container on the way to a view show it."""

    def __init__(self, path):
        reader = RrdReader(str(path))
        (store,) = reader.blueprints()
        self.application = store.application_id
        self.chunks = list(reader.stream(store=store))
        self.names, self.contents, self.tabbed, self.queries, self.chosen = {}, {}, set(), {}, {}
        for chunk in self.chunks:
            batch, entity = chunk.to_record_batch().to_pydict(), str(chunk.entity_path).lstrip("/")
            for archetype in ["ContainerBlueprint", "ViewBlueprint"]:
                if f"{archetype}:display_name" in batch:
                    self.names[entity] = batch[f"{archetype}:display_name"][0][0]
            if "ContainerBlueprint:contents" in batch:
                self.contents[entity] = [part.lstrip("/") for part in batch["ContainerBlueprint:contents"][0]]
                if "ContainerBlueprint:active_tab" in batch:
                    self.tabbed.add(entity)
            if "ViewContents:query" in batch:
                self.queries[entity.removesuffix("/ViewContents")] = batch["ViewContents:query"][0]
        parts = {part for contents in self.contents.values() for part in contents}
        (self.root,) = set(self.contents) - parts

    def tabs(self):
        """Every outer tab with every tab of its first inner container; the other inner ones turn with it."""
        for tab in self.contents[self.root]:
            inner = [container for container in self.below(tab) if container in self.tabbed]
            for number in range(len(self.contents[inner[0]]) if inner else 1):
                chosen = {self.root: tab}
                for container in inner:
                    parts = self.contents[container]
                    chosen[container] = parts[number % len(parts)]
                yield chosen, [self.names[part] for part in chosen.values()]

    def below(self, container):
        """The containers within a container, and itself."""
        if container not in self.contents:
            return []
        return [container, *(it for part in self.contents[container] for it in self.below(part))]

    def shown(self, container=None):
        """The views on show."""
        container = container or self.root
        if container not in self.contents:
            return [container]
        parts = self.contents[container]
        if container in self.tabbed:
            parts = [self.chosen.get(container, parts[0])]
        return [view for part in parts for view in self.shown(part)]

    def _log_to_stream(self, stream):
        send_chunks(self.chunks, recording=stream)
        stream.set_time("blueprint", sequence=1)
        for container, part in self.chosen.items():
            stream.log(container, rerun.blueprint.archetypes.ContainerBlueprint.from_fields(active_tab=part))


def main():
    recording, out = map(pathlib.Path, sys.argv[1:])
    program = pathlib.Path(rerun_cli.__file__).with_name("rerun")
    subprocess.run([program, "rrd", "verify", recording], check=True)
    entities = {str(chunk.entity_path) for chunk in RrdReader(str(recording)).stream()}
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
        url = f"rerun+http://127.0.0.1:{port}/proxy"
        client = ViewerClient.connect(url)
        layout = Layout(recording)
        pictures = set()
        for layout.chosen, names in layout.tabs():
            name = "_".join(re.sub(r"\W+", "-", part) for part in names)
            layout.connect_grpc(layout.application, url=url, make_active=True, make_default=False)
            picture = out / f"recording_{name}.png"
            colors = still(client, picture)
            assert colors not in pictures, f"{picture} is as another tab"
            pictures.add(colors)
            views = layout.shown()
            assert views, f"{name} has no views"
            for view in views:
                for query in layout.queries[view]:
                    prefix = query.removeprefix("+ ").removesuffix("/**")
                    assert any(entity.startswith(prefix) for entity in entities), \
                        f"{name}: {layout.names[view]} shows {query}, which nothing is logged to"
            print(f"{' / '.join(names)}: {len(views)} views, {picture}")
    finally:
        viewer.terminate()
        viewer.wait(30)


def still(client, picture):
    """The colours of a picture that does not change any more: plots move into place, slowly on a busy machine."""
    before = None
    for _ in range(30):
        time.sleep(3)
        client.save_screenshot(str(picture.resolve()))
        colors = check(picture, 200)
        if colors == before:
            return colors
        before = colors
    raise AssertionError(f"{picture} does not come to rest")


def check(picture, least):
    """The picture's colours, which must be many."""
    colors = []
    for _ in range(50):
        try:
            colors = Image.open(picture).convert("RGB").getcolors(1 << 24)
            break
        except OSError:  # The viewer is still writing it.
            time.sleep(0.2)
    assert len(colors) >= least, f"{picture} is empty: {len(colors)} colours"
    return tuple(sorted(colors))


assert rerun.__version__ == "0.36.3", rerun.__version__
main()
