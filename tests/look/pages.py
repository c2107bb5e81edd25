"""Pages in headless Chromium: no error, nothing loaded, no overflow on a phone or on paper, pictures that are not empty."""

import base64
import json
import os
import pathlib
import subprocess
import sys
import tempfile

from PIL import Image

FLAGS = """--headless=new --no-sandbox --disable-gpu --disable-quic --no-first-run --disable-background-networking
--disable-component-update --disable-sync --hide-scrollbars --remote-debugging-pipe""".split()


class Browser:
    """Chromium, spoken to through its two pipes."""

    def __init__(self, directory):
        to_child, self.write_to = os.pipe()
        self.read_from, from_child = os.pipe()

        def pipes():
            # First out of the way of 3 and 4.
            read, write = os.dup(to_child), os.dup(from_child)
            os.dup2(read, 3)
            os.dup2(write, 4)

        self.process = subprocess.Popen(
            [os.environ.get("CHROMIUM", "chromium"), *FLAGS, f"--user-data-dir={directory}"],
            preexec_fn=pipes, close_fds=False, stderr=subprocess.DEVNULL)
        self.buffer, self.number, self.events = b"", 0, []

    def receive(self):
        while b"\0" not in self.buffer:
            part = os.read(self.read_from, 1 << 20)
            if not part:
                sys.exit("the browser has gone away")
            self.buffer += part
        message, self.buffer = self.buffer.split(b"\0", 1)
        return json.loads(message)

    def call(self, method, session=None, **parameters):
        self.number += 1
        message = {"id": self.number, "method": method, "params": parameters}
        if session:
            message["sessionId"] = session
        os.write(self.write_to, json.dumps(message).encode() + b"\0")
        while True:
            answer = self.receive()
            if answer.get("id") == self.number:
                if "error" in answer:
                    sys.exit(f"{method}: {answer['error']}")
                return answer["result"]
            self.events.append(answer)

    def wait_for(self, method):
        while not any(event.get("method") == method for event in self.events):
            self.events.append(self.receive())


def use(evaluate, name):
    """What the script does: values where maps are pointed at, sorted tables, methods that are switched off."""
    tip = evaluate("""(() => {
        const image = document.querySelector('image[data-values]');
        if (!image) return 'no map';
        image.scrollIntoView();
        const box = image.getBoundingClientRect();
        const at = { bubbles: true, clientX: box.left + box.width / 2, clientY: box.top + box.height / 2 };
        image.dispatchEvent(new PointerEvent('pointermove', at));
        const tip = document.querySelector('.tip');
        return tip.hidden ? 'hidden' : tip.textContent;
    })()""")
    assert tip == "no map" or (" km" in tip and " at " in tip), f"{name}: a map says {tip}"
    maps = evaluate("""(() => {
        const slider = document.querySelector('.player input'), choice = document.querySelector('.player select');
        if (!slider) return 'no slider';
        const shown = () => [...document.querySelectorAll('figure[data-cycle]:not([hidden])')].map(it => it.dataset);
        slider.value = 0;
        slider.dispatchEvent(new Event('input'));
        const cycles = new Set(shown().map(it => it.cycle)), kinds = new Set(shown().map(it => it.kind));
        choice.selectedIndex = choice.options.length - 1;
        choice.dispatchEvent(new Event('change'));
        const own = shown().every(it => it.kind == 'truth' || it.method == choice.value) && shown().length >= 4;
        slider.value = slider.max;
        slider.dispatchEvent(new Event('input'));
        choice.selectedIndex = 0;
        choice.dispatchEvent(new Event('change'));
        return `${cycles.size} cycle, ${[...kinds].sort().join(' and ')}, ${own ? 'then one method' : 'then others'}`;
    })()""")
    assert maps in ("no slider", "1 cycle, error and truth, then one method"), f"{name}: the slider shows {maps}"
    order = evaluate("""(() => {
        const table = [...document.querySelectorAll('table')].find(it => it.tBodies[0].rows.length > 2);
        if (!table) return [];
        const column = table.tHead.rows[0].cells.length - 1;
        table.tHead.rows[0].cells[column].click();
        const values = [...table.tBodies[0].rows].map(row => parseFloat(row.cells[column].firstChild.textContent));
        return values.filter(value => !Number.isNaN(value));
    })()""")
    assert order == sorted(order), f"{name}: a table that is not sorted: {order}"
    hidden = evaluate("""(() => {
        const item = document.querySelector('.switches [data-color]');
        if (!item) return 'no switches';
        const drawn = document.querySelector(`.curves [stroke="${item.dataset.color}"]`);
        item.querySelector('input').click();
        const display = getComputedStyle(drawn).display;
        item.querySelector('input').click();
        return `${display}, then ${getComputedStyle(drawn).display}`;
    })()""")
    assert hidden in ("no switches", "none, then inline"), f"{name}: a method switched off is {hidden}"
    evaluate("scrollTo(0, 0)")


def look(browser, page, width, dark, picture, whole):
    target = browser.call("Target.createTarget", url="about:blank")["targetId"]
    session = browser.call("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
    call = lambda method, **parameters: browser.call(method, session, **parameters)
    browser.events = []
    for domain in ["Page", "Runtime", "Log", "Network"]:
        call(f"{domain}.enable")
    scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
    call("Emulation.setEmulatedMedia", features=[scheme])
    call("Emulation.setDeviceMetricsOverride", width=width, height=900, deviceScaleFactor=1, mobile=width < 600)
    call("Page.navigate", url=page.resolve().as_uri())
    browser.wait_for("Page.loadEventFired")
    evaluate = lambda text: call("Runtime.evaluate", expression=text, returnByValue=True)["result"].get("value")
    evaluate("document.querySelectorAll('details').forEach(it => it.open = true)")
    found = evaluate("""({
        scroll: document.documentElement.scrollWidth, width: innerWidth,
        wide: [...document.querySelectorAll('body *')].filter(it => !it.closest('.scroll, nav, svg')
            && it.getBoundingClientRect().right > innerWidth + 1).map(it => it.tagName + ' ' + it.className).slice(0, 5),
        figures: document.querySelectorAll('figure').length,
        flat: [...document.querySelectorAll('figure:not([hidden]) :is(svg, img)')].filter(it => it.getBoundingClientRect().height < 50
            || (it.tagName == 'IMG' && !it.naturalWidth)).length,
        background: getComputedStyle(document.body).backgroundColor,
        columns: [...document.querySelectorAll('table')].every(table => new Set([...table.rows].map(row =>
            row.cells.length)).size == 1),
        tables: document.querySelectorAll('table').length})""")
    if whole:
        use(evaluate, page.name)
    if not whole:
        evaluate("document.querySelectorAll('details').forEach(it => it.open = false)")
    height = min(evaluate("document.documentElement.scrollHeight"), 14000)
    clip = {"x": 0, "y": 0, "width": width, "height": height, "scale": 1}
    data = call("Page.captureScreenshot", clip=clip, captureBeyondViewport=True)["data"]
    picture.write_bytes(base64.b64decode(data))
    loud = [event for event in browser.events
            if event["method"] in ("Runtime.exceptionThrown", "Log.entryAdded")
            or event["method"] == "Runtime.consoleAPICalled"]
    asked = [event["params"]["request"]["url"] for event in browser.events
             if event["method"] == "Network.requestWillBeSent"]
    foreign = [url[:80] for url in asked if not url.startswith(("file:", "data:"))]
    others = [url for url in asked if url.startswith("file:")]
    name = f"{page.name} at {width} px, {'dark' if dark else 'light'}"
    assert not loud, f"{name}: {loud}"
    assert not foreign and len(others) == 1, f"{name} loads {foreign} {others}"
    assert found["scroll"] <= found["width"] and not found["wide"], f"{name} is too wide: {found}"
    assert found["figures"] >= 4 and found["flat"] == 0, f"{name}: figures are missing or flat: {found}"
    assert found["tables"] >= 2 and found["columns"], f"{name}: a table has holes: {found}"
    shades = [int(part) for part in found["background"][4:-1].split(",")]
    assert (max(shades) < 60) == dark, f"{name} has the wrong background: {found}"
    colors = Image.open(picture).convert("RGB").getcolors(1 << 24)
    assert len(colors) > 100, f"{name}: the picture is empty"
    print(f"{name}: {found['figures']} figures, {found['tables']} tables, {len(colors)} colours, {picture}")
    browser.call("Target.closeTarget", targetId=target)


def paper(browser, page, document):
    """The page as it is printed on A4: nothing wider than the paper between its margins."""
    target = browser.call("Target.createTarget", url="about:blank")["targetId"]
    session = browser.call("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
    call = lambda method, **parameters: browser.call(method, session, **parameters)
    browser.events = []
    call("Page.enable")
    call("Emulation.setEmulatedMedia", media="print", features=[{"name": "prefers-color-scheme", "value": "dark"}])
    width = round((210 - 24) / 25.4 * 96)
    call("Emulation.setDeviceMetricsOverride", width=width, height=1000, deviceScaleFactor=1, mobile=False)
    call("Page.navigate", url=page.resolve().as_uri())
    browser.wait_for("Page.loadEventFired")
    found = call("Runtime.evaluate", returnByValue=True, expression="""({
        wide: [...document.querySelectorAll('body *')].filter(it => !it.closest('svg')
            && it.getBoundingClientRect().right > innerWidth + 1).map(it => it.tagName + ' ' + it.textContent.slice(0, 30)),
        background: getComputedStyle(document.body).backgroundColor})""")["result"]["value"]
    assert not found["wide"], f"{page.name} on paper is too wide: {found['wide'][:5]}"
    assert found["background"] == "rgb(255, 255, 255)", f"{page.name} on paper: {found['background']}"
    data = call("Page.printToPDF", paperWidth=8.27, paperHeight=11.69, preferCSSPageSize=True)["data"]
    document.write_bytes(base64.b64decode(data))
    print(f"{page.name} on paper: {document}")
    browser.call("Target.closeTarget", targetId=target)


def main():
    *pages, out = map(pathlib.Path, sys.argv[1:])
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as directory:
        browser = Browser(directory)
        for page in pages:
            for width, dark in [(1400, False), (1400, True), (400, False), (400, True)]:
                name = f"{page.stem}_{width}_{'dark' if dark else 'light'}.png"
                look(browser, page, width, dark, out / name, whole=width == 1400 and not dark)
            paper(browser, page, out / f"{page.stem}.pdf")
        browser.call("Browser.close")
        browser.process.wait(30)


main()
