// The table of rows: sorted by a head, filtered below it, only what is in sight is there.

const LINE = 26, SIGHT = 14; // height of a row [px], rows in sight

// "<0.1", ">= 3", "1..2", "=5", or a part of a name.
function testOf(text) {
  const words = text.trim();
  if (!words) return null;
  const number = "([-+]?(?:\\d+\\.?\\d*|\\.\\d+)(?:e[-+]?\\d+)?)";
  let found = words.match(new RegExp(`^(<=|>=|<|>|=|≤|≥)?\\s*${number}$`, "i"));
  if (found) {
    const limit = Number(found[2]);
    switch (found[1]) {
      case "<": return (value) => value < limit;
      case "<=": case "≤": return (value) => value <= limit;
      case ">": return (value) => value > limit;
      case ">=": case "≥": return (value) => value >= limit;
      default: return (value) => Math.abs(value - limit) <= 5e-4 * Math.abs(limit);
    }
  }
  found = words.match(new RegExp(`^${number}\\s*(?:\\.\\.|…|to)\\s*${number}$`, "i"));
  if (found) return (value) => value >= Number(found[1]) && value <= Number(found[2]);
  return undefined;
}

function tableView(state, box) {
  const { rows } = state, measures = rows.measures;
  let order = new Uint32Array(0), by = state.goals[0], down = measures.find((each) => each.name === by).sense === "floor";
  const head = element("tr"), filters = element("tr", { className: "filters" }), body = element("tbody");
  const table = element("table", {}, element("thead", {}, head, filters), body);
  const above = element("div"), below = element("div");
  const sight = element("div", { className: "sight", tabIndex: 0, role: "region" }, above, table, below);
  sight.setAttribute("aria-label", "rows; ↑ ↓, Home and End choose one, which is shown below");
  sight.style.maxHeight = `${(SIGHT + 2.6) * LINE}px`;
  const columns = [{ name: "", head: "row", unit: "-", text: "its name" }, { name: "status", head: "status", unit: "-", text: `the worst, ${rows.group} by ${rows.group}` }, ...measures];

  const titles = columns.map((each) => {
    const button = element("button", { textContent: heading(each), title: each.text, onclick: () => sort(each.name) });
    const cell = element("th", { scope: "col" }, button);
    head.append(cell);
    const filter = element("input", { type: "text", placeholder: each.name && each.name !== "status" ? "<, >, a..b" : "part", size: 6 });
    filter.setAttribute("aria-label", `filter of ${heading(each)}`);
    filter.addEventListener("input", () => {
      const plain = each.name === "" || each.name === "status", words = filter.value.trim().toLowerCase();
      const test = plain ? words && ((i) => (each.name ? statusOf(i) : rows.names[i]).toLowerCase().includes(words)) : testOf(filter.value);
      filter.classList.toggle("wrong", test === undefined);
      state.texts.delete(each.name);
      if (each.name === "status") state.texts.delete("");
      if (test) state.texts.set(plain ? "" : each.name, test);
      state.filter();
    });
    filters.append(element("td", {}, filter));
    return { cell, name: each.name, filter };
  });

  function statusOf(i) {
    let worst = 0;
    rows.tissues.forEach((_, t) => {
      if (state.tissue < 0 || t === state.tissue) worst = Math.max(worst, rows.status[t * state.count + i]);
    });
    return rows.states[worst].name;
  }

  function sort(name) {
    down = by === name ? !down : false;
    by = name;
    arrange();
    sight.scrollTop = 0;
    show();
  }

  function arrange() {
    const found = new Uint32Array(state.shown);
    for (let i = 0, at = 0; i < state.count; i++) if (state.alive[i]) found[at++] = i;
    const each = state.measures.get(by);
    if (each) {
      const values = state.values(by), sign = down ? -1 : 1;
      // Sorting keys that are there is several times faster than asking for them; – comes last either way.
      const keys = Float64Array.from(found, (i) => (values[i] === values[i] ? sign * values[i] : Infinity));
      const places = Uint32Array.from(found, (_, at) => at).sort((a, b) => keys[a] - keys[b] || a - b);
      order = places.map((at) => found[at]);
    } else {
      order = found;
      if (by === "status") order = Uint32Array.from([...found].sort((a, b) => statusOf(a).localeCompare(statusOf(b)) || a - b));
      if (down) order.reverse();
    }
    for (const { cell, name } of titles) cell.setAttribute("aria-sort", name !== by ? "none" : down ? "descending" : "ascending");
  }

  function show() {
    const first = Math.max(0, Math.min(Math.floor(sight.scrollTop / LINE) - 4, order.length - SIGHT));
    const last = Math.min(order.length, first + SIGHT + 12);
    above.style.height = `${first * LINE}px`;
    below.style.height = `${(order.length - last) * LINE}px`;
    body.replaceChildren(...Array.from(order.subarray(first, last), (i) => {
      const line = element("tr", { onclick: () => state.choose(i), className: state.feasible[i] ? "" : "broken" });
      line.dataset.row = i;
      if (i === state.chosen) line.setAttribute("aria-selected", "true");
      line.append(element("th", { scope: "row", textContent: rows.names[i] + (rows.details[i] ? " ●" : "") }), element("td", { textContent: statusOf(i) }));
      for (const each of measures) line.append(element("td", { textContent: written(each, state.values(each.name)[i]) }));
      return line;
    }));
  }

  sight.addEventListener("scroll", show);
  sight.addEventListener("keydown", (event) => {
    if (event.target !== sight || !["ArrowDown", "ArrowUp", "Home", "End"].includes(event.key) || !order.length) return;
    const at = order.indexOf(state.chosen);
    const next = { ArrowDown: at + 1, ArrowUp: at < 0 ? 0 : at - 1, Home: 0, End: order.length - 1 }[event.key];
    const to = Math.min(order.length - 1, Math.max(0, next));
    if (to * LINE < sight.scrollTop) sight.scrollTop = to * LINE;
    if ((to + 1) * LINE > sight.scrollTop + (SIGHT - 1) * LINE) sight.scrollTop = (to + 2 - SIGHT) * LINE;
    state.choose(order[to]);
    event.preventDefault();
  });

  function csv() {
    const quote = (text) => (/[",\n]/.test(text) ? `"${text.replaceAll('"', '""')}"` : text);
    const lines = [["row", "status", ...measures.map(heading)].map(quote).join(",")];
    for (const i of order) {
      lines.push([rows.names[i], statusOf(i), ...measures.map((each) => String(state.values(each.name)[i]))].map(quote).join(","));
    }
    save("rows.csv", lines.join("\n") + "\n");
  }

  box.append(
    element("div", { className: "bar" }, element("button", { textContent: "Save the rows shown as CSV", onclick: csv })),
    sight,
    element("p", { className: "note" }, rows.note ? `● ${rows.note}` : ""),
  );
  const renew = later(() => {
    arrange();
    show();
  });
  state.on(["filter"], renew);
  state.on(["chosen"], () => {
    const at = order.indexOf(state.chosen) * LINE;
    if (at >= 0 && (at < sight.scrollTop || at > sight.scrollTop + (SIGHT - 1) * LINE)) sight.scrollTop = at - 4 * LINE;
    show();
  });
  arrange();
  show();
  return () => titles.forEach(({ filter }) => {
    filter.value = "";
    filter.classList.remove("wrong");
  });
}

function save(name, text) {
  const link = element("a", { href: URL.createObjectURL(new Blob([text], { type: "text/plain" })), download: name });
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 1000);
}
