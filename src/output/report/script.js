"use strict";
// Values of maps where they are pointed at, maps cycle by cycle, tables by column, methods switched on and off. The page is
// complete without it.
(() => {
  const tip = document.createElement("div");
  tip.className = "tip";
  tip.hidden = true;
  document.body.append(tip);
  const values = new Map();
  const decoded = image => {
    if (!values.has(image)) {
      const bytes = Uint8Array.from(atob(image.dataset.values), letter => letter.charCodeAt(0));
      values.set(image, new DataView(bytes.buffer));
    }
    return values.get(image);
  };
  const digits = (value, step) => value.toFixed(Math.min(6, Math.max(0, 2 - Math.floor(Math.log10(step * 32000)))));
  document.addEventListener("pointermove", event => {
    const image = event.target.closest ? event.target.closest("svg")?.querySelector("image[data-values]") : null;
    const box = image?.getBoundingClientRect();
    const [x, y] = box ? [(event.clientX - box.left) / box.width, (box.bottom - event.clientY) / box.height] : [-1, -1];
    tip.hidden = !(x >= 0 && x < 1 && y >= 0 && y < 1);
    if (tip.hidden) return;
    const data = decoded(image), columns = Number(image.dataset.nx), rows = data.byteLength / 2 / columns;
    const number = data.getInt16(2 * (Math.floor(y * rows) * columns + Math.floor(x * columns)), true);
    const step = Number(image.dataset.step), [width, height] = image.dataset.km.split(" ").map(Number);
    const value = number === -32768 ? "no value" : digits(number * step, step);
    tip.textContent = `${value} at ${Math.round(x * width)}, ${Math.round(y * height)} km`;
    tip.style.left = `${Math.min(event.pageX + 14, innerWidth - 190)}px`;
    tip.style.top = `${event.pageY + 16}px`;
  });
  const maps = [...document.querySelectorAll("figure[data-cycle]")];
  const cycles = [...new Set(maps.map(map => map.dataset.cycle))].sort((a, b) => a - b);
  if (cycles.length > 1) {
    const make = (name, values) => Object.assign(document.createElement(name), values);
    const labelled = (text, item) => {
      const label = make("label", { textContent: text });
      label.append(item);
      return label;
    };
    const grid = maps[0].parentElement, heading = grid.closest("section").querySelector("h2");
    const title = heading.textContent.split(":")[0];
    const slider = make("input", { type: "range", min: 0, max: cycles.length - 1, value: cycles.length - 1 });
    const when = make("output"), choice = make("select"), player = make("p", { className: "player" });
    const kind = maps.some(map => map.dataset.kind === "error") ? "error" : "analysis";
    const names = [...new Set(maps.map(map => map.dataset.method).filter(name => name))];
    choice.append(new Option(`${kind} of every method`, ""), ...names.map(name => new Option(`all maps of ${name}`, name)));
    player.append(labelled("Cycle", slider), when, labelled("Show", choice));
    const folds = new Set(maps.map(map => map.closest("details")).filter(fold => fold));
    grid.before(player);
    grid.append(...maps);
    folds.forEach(fold => { if (!fold.querySelector("figure")) fold.remove(); });
    const show = () => {
      const cycle = cycles[slider.value], own = maps.filter(map => map.dataset.cycle === cycle);
      maps.forEach(map => { map.hidden = true; });
      for (const map of own) {
        const isChosen = choice.value ? map.dataset.method === choice.value : map.dataset.kind === kind;
        map.hidden = !isChosen && map.dataset.kind !== "truth";
      }
      when.textContent = own[0].dataset.when.replace("cycle ", "");
      heading.textContent = `${title}: ${own[0].dataset.when}`;
    };
    slider.addEventListener("input", show);
    choice.addEventListener("change", show);
    show();
  }
  const rank = cell => {
    const number = parseFloat(cell.firstChild?.textContent.replace("−", "-"));
    return Number.isNaN(number) ? Infinity : number;
  };
  for (const table of document.querySelectorAll("table")) {
    const heads = table.tHead?.rows[0]?.cells ?? [];
    [...heads].forEach((head, column) => {
      head.tabIndex = 0;
      head.classList.add("sorts");
      const sort = () => {
        const down = head.getAttribute("aria-sort") === "ascending";
        [...heads].forEach(other => other.removeAttribute("aria-sort"));
        head.setAttribute("aria-sort", down ? "descending" : "ascending");
        const by = column ? (a, b) => rank(a.cells[column]) - rank(b.cells[column])
          : (a, b) => a.cells[0].textContent.localeCompare(b.cells[0].textContent);
        const rows = [...table.tBodies[0].rows].sort((a, b) => by(a, b) || 0);
        table.tBodies[0].append(...(down ? rows.reverse() : rows));
      };
      head.addEventListener("click", sort);
      head.addEventListener("keydown", event => { if (event.key === "Enter") sort(); });
    });
  }
  const switches = document.querySelector(".switches");
  const hidden = document.createElement("style");
  document.head.append(hidden);
  for (const item of switches?.querySelectorAll("[data-color]") ?? []) {
    const box = document.createElement("input");
    box.type = "checkbox";
    box.checked = true;
    item.prepend(box);
    box.addEventListener("change", () => {
      const off = [...switches.querySelectorAll("[data-color]")].filter(it => !it.querySelector("input").checked);
      hidden.textContent = off.map(it => `.curves [stroke="${it.dataset.color}"], .curves [fill="${it.dataset.color}"]`)
        .join(",") + (off.length ? " { display: none; }" : "");
    });
  }
  switches?.removeAttribute("hidden");
})();
