// Parallel coordinates: brushing, log axes, 10⁵ rows and more. Few rows are lines; many are a density, summed
// over pairs of heights on neighbouring axes, so that its cost does not grow with the rows.

const LEVELS = 256, NOWHERE = 250, HIGHEST = 239; // heights of a picture; where ∞ and – lie; the last of the values
const FAR = 3; // times the worst of the rows that keep the limits, where an axis ends
const FEW = 1500; // rows that are drawn one by one
const TOP = 52, HEIGHT = 300, BOTTOM = 24, SIDE = 56, NARROW = 96; // [px]

function parallelView(state, box) {
  const initial = [...state.measures.values()];
  const shownFirst = new Set(initial.filter((each) => each.role === "parameter").slice(0, 6).map((each) => each.name));
  state.goals.filter(Boolean).forEach((name) => shownFirst.add(name));
  initial.filter((each) => each.role === "margin").slice(0, 3).forEach((each) => shownFirst.add(each.name));
  let axes = initial.filter((each) => shownFirst.has(each.name)).map((each) => ({ each, log: each.log }));
  let tint = state.goals[0], tints = new Uint8Array(state.count), tintEnds = [0, 1];

  const stage = element("div", { className: "stage" });
  const canvases = ["back", "front", "over"].map((name) => element("canvas", { className: name }));
  const heads = element("div", { className: "heads" });
  stage.append(...canvases, heads);
  const told = element("span", { className: "soft", id: "brush-time" });
  const tintChoice = choice("Colour", initial.filter((each) => each.role !== "other").map((each) => [each.name, heading(each)]), tint, (name) => {
    tint = name;
    colour();
    draw();
  });
  const picks = element("details", { className: "picks" }, element("summary", { textContent: "Axes" }));
  for (const each of initial) {
    const tick = element("input", { type: "checkbox", checked: shownFirst.has(each.name) });
    tick.addEventListener("change", () => {
      axes = tick.checked ? [...axes, { each, log: each.log }] : axes.filter((one) => one.each !== each);
      if (!tick.checked) state.setRange(each.name, null);
      axes.sort((a, b) => initial.indexOf(a.each) - initial.indexOf(b.each));
      layout();
    });
    picks.append(element("label", { title: each.text }, tick, ` ${heading(each)}`));
  }
  box.append(
    element("div", { className: "bar" }, tintChoice, picks, told),
    stage,
    element("p", { className: "note" }, "Drag along an axis to brush, double-click it to let go; its name switches between linear and log. By keys: Tab to an axis, ↑ ↓ move a brush, Shift+↑ ↓ change its height, Delete lets go. Rows below the axes have no finite value, those that are far worse than all that keep the limits lie at the end; grey rows break a limit."),
  );

  const place = (axisAt, value) => {
    const { low, high, log } = axisAt;
    if (!Number.isFinite(value) || (log && value <= 0)) return NOWHERE;
    const share = log ? Math.log(value / low) / Math.log(high / low) : (value - low) / (high - low);
    return Math.round((1 - Math.min(1, Math.max(0, high > low ? share : 0.5))) * HIGHEST);
  };
  const valueAt = (one, level) => {
    const share = 1 - level / HIGHEST;
    return one.log ? one.low * Math.pow(one.high / one.low, share) : one.low + share * (one.high - one.low);
  };

  function measureAxis(one) {
    const values = state.values(one.each.name);
    let low = Infinity, high = -Infinity, positive = Infinity;
    for (let i = 0; i < values.length; i++) {
      const value = values[i];
      if (!Number.isFinite(value)) continue;
      if (value < low) low = value;
      if (value > high) high = value;
      if (value > 0 && value < positive) positive = value;
    }
    one.log = one.log && positive < high;
    Object.assign(one, low <= high ? { low: one.log ? positive : low, high } : { low: 0, high: 1 });
    Object.assign(one, { least: low, most: high });
    // What is far worse than every row that keeps the limits lies at the end of the axis, or it would squeeze the rest.
    const ends = endsOfKept(values);
    if (one.each.sense === "ceiling") one.high = Math.min(one.high, FAR * ends[1]);
    if (one.each.sense === "floor" && one.low > 0) one.low = Math.max(one.low, ends[0] / FAR);
    one.levels = new Uint8Array(values.length);
    for (let i = 0; i < values.length; i++) one.levels[i] = place(one, values[i]);
  }

  // Least and largest value of the rows that keep the limits; all there is where none does.
  function endsOfKept(values) {
    let low = Infinity, high = -Infinity;
    for (let i = 0; i < values.length; i++) {
      if (!state.feasible[i] || !Number.isFinite(values[i])) continue;
      low = Math.min(low, values[i]);
      high = Math.max(high, values[i]);
    }
    return high > 0 ? [low, high] : [-Infinity, Infinity];
  }

  function colour() {
    const values = state.values(tint), each = state.measures.get(tint);
    const finite = Float64Array.from(values).filter(Number.isFinite).sort();
    // The worst twentieth would leave one colour for all others.
    const cut = (share) => finite[Math.min(finite.length - 1, Math.floor(share * finite.length))];
    const [low, high] = each.sense === "floor" ? [cut(0.05), cut(1)] : [cut(0), cut(each.sense === "none" ? 1 : 0.95)];
    const log = each.log && low > 0, scale = log ? Math.log(high / low) : high - low;
    tintEnds = [low, high];
    for (let i = 0; i < values.length; i++) {
      const share = scale > 0 ? (log ? Math.log(values[i] / low) : values[i] - low) / scale : 0;
      tints[i] = values[i] === values[i] ? Math.round(255 * Math.min(1, Math.max(0, share))) : 255;
    }
  }

  let width = 0, gap = 0;
  const left = (k) => SIDE + k * gap;

  function layout() {
    axes.forEach(measureAxis);
    // On a narrow page the axes keep their distance and the picture scrolls.
    width = Math.max(stage.clientWidth, 2 * SIDE + NARROW * (axes.length - 1));
    gap = axes.length > 1 ? (width - 2 * SIDE) / (axes.length - 1) : 0;
    const ratio = devicePixelRatio || 1;
    for (const canvas of canvases) {
      canvas.width = width * ratio;
      canvas.height = (TOP + HEIGHT + BOTTOM) * ratio;
      canvas.style.width = `${width}px`;
      canvas.style.height = `${TOP + HEIGHT + BOTTOM}px`;
      canvas.getContext("2d").setTransform(ratio, 0, 0, ratio, 0, 0);
    }
    stage.style.height = `${TOP + HEIGHT + BOTTOM + (width > stage.clientWidth ? 16 : 0)}px`;
    headsOf();
    paint(canvases[0], null, true);
    draw();
  }

  function headsOf() {
    heads.replaceChildren(...axes.map((one, k) => {
      const name = element("button", {
        className: "axis-name", textContent: heading(one.each), title: `${one.each.text}; ${one.log ? "log" : "linear"} axis: press to switch`,
        onclick: () => {
          one.log = !one.log;
          layout();
          heads.querySelectorAll("button")[k].focus();
        },
      });
      name.append(element("small", { textContent: one.log ? " log" : "" }));
      // Narrow axes: a name wraps before it lies on its neighbour's.
      name.style.maxWidth = `${Math.min(112, Math.max(gap, NARROW) - 6)}px`;
      const rail = element("div", { className: "rail", tabIndex: 0, role: "slider" });
      rail.setAttribute("aria-orientation", "vertical");
      rail.dataset.name = one.each.name;
      speak(rail, one);
      drag(rail, one);
      rail.addEventListener("keydown", (event) => keys(event, rail, one));
      const column = element("div", { className: "axis" }, name, rail);
      column.style.left = `${left(k)}px`;
      return column;
    }));
  }

  function speak(rail, one) {
    const range = state.ranges.get(one.each.name);
    rail.setAttribute("aria-label", `brush of ${heading(one.each)}`);
    rail.setAttribute("aria-valuemin", short(one.low));
    rail.setAttribute("aria-valuemax", short(one.high));
    rail.setAttribute("aria-valuenow", short(range ? range[0] : one.low));
    rail.setAttribute("aria-valuetext", range ? `${short(range[0])} to ${short(range[1])}` : "no brush");
  }

  function brush(one, from, to, rail) {
    const began = performance.now();
    const [top, bottom] = from < to ? [from, to] : [to, from];
    // A brush at the very end of an axis means all beyond it: rounding must not lose the last row.
    const slack = 1e-9 * (Math.abs(one.low) + Math.abs(one.high));
    const low = bottom >= HIGHEST ? one.least - slack : valueAt(one, bottom), high = top <= 0 ? one.most + slack : valueAt(one, top);
    state.setRange(one.each.name, [low, high]);
    speak(rail, one);
    told.textContent = `drawn in ${Math.round(performance.now() - began)} ms`;
    told.dataset.ms = performance.now() - began;
  }

  function drag(rail, one) {
    const level = (event) => Math.min(HIGHEST, Math.max(0, ((event.clientY - rail.getBoundingClientRect().top) / HEIGHT) * LEVELS));
    let from = null, next = null;
    rail.addEventListener("pointerdown", (event) => {
      from = level(event);
      hand.down = true;
      rail.setPointerCapture(event.pointerId);
    });
    rail.addEventListener("pointermove", (event) => {
      if (from === null) return;
      const waiting = next !== null;
      next = level(event);
      if (!waiting) requestAnimationFrame(() => {
        if (next !== null && from !== null) brush(one, from, next, rail);
        next = null;
      });
    });
    const release = (event) => {
      if (from !== null && Math.abs(level(event) - from) > 2) brush(one, from, level(event), rail);
      from = next = null;
      hand.down = false;
    };
    rail.addEventListener("pointerup", release);
    rail.addEventListener("pointercancel", () => {
      from = next = null;
      hand.down = false;
    });
    rail.addEventListener("dblclick", () => {
      state.setRange(one.each.name, null);
      speak(rail, one);
    });
  }

  function keys(event, rail, one) {
    const range = state.ranges.get(one.each.name), step = 8;
    if (event.key === "Delete" || event.key === "Backspace" || event.key === "Escape") {
      state.setRange(one.each.name, null);
      speak(rail, one);
    } else if (event.key === "ArrowUp" || event.key === "ArrowDown") {
      let [top, bottom] = range ? [place(one, range[1]), place(one, range[0])] : [HIGHEST / 2 + 30, HIGHEST];
      const by = event.key === "ArrowUp" ? -step : step;
      if (event.shiftKey) top = Math.max(0, Math.min(bottom - step, top + by));
      else if (range) {
        const moved = Math.max(-top, Math.min(HIGHEST - bottom, by));
        top += moved;
        bottom += moved;
      }
      brush(one, top, bottom, rail);
    } else return;
    event.preventDefault();
  }

  // All rows in grey, or those that are left in colour.
  function paint(canvas, takes, faint) {
    const context = canvas.getContext("2d"), colors = ink();
    context.clearRect(0, 0, width, TOP + HEIGHT + BOTTOM);
    if (faint) {
      context.fillStyle = colors.page;
      context.fillRect(0, TOP - 8, width, HEIGHT + BOTTOM + 8); // names of the axes are text of the page
    }
    if (axes.length < 2) return;
    const count = takes ? state.shown : state.count;
    if (count <= FEW) strokes(context, takes, faint, colors);
    else density(context, takes, faint, count);
  }

  function strokes(context, takes, faint, colors) {
    const scale = HEIGHT / LEVELS;
    context.lineWidth = 1;
    context.globalAlpha = faint ? 0.25 : Math.max(0.25, Math.min(0.9, 120 / state.shown));
    for (let i = 0; i < state.count; i++) {
      if (takes && !takes[i]) continue;
      const good = state.feasible[i];
      context.strokeStyle = faint || !good ? colors.dead : rgb(RAMP[tints[i]]);
      context.setLineDash(good || faint ? [] : [2, 3]);
      context.beginPath();
      axes.forEach((one, k) => context[k ? "lineTo" : "moveTo"](left(k), TOP + one.levels[i] * scale));
      context.stroke();
    }
    context.setLineDash([]);
    context.globalAlpha = 1;
  }

  const LONG = 65536, floats = () => new Float32Array(LONG);
  const sums = { all: floats(), good: floats(), tint: floats() }; // by pair of heights
  const used = { from: floats(), rise: floats(), all: floats(), good: floats(), tint: floats() };
  const scratch = document.createElement("canvas");

  // Sums of the rows over pairs of heights of two axes, those that occur in a list; how many do.
  function gather(a, b, takes, fine) {
    const { feasible, count } = state, shift = fine ? 0 : 1, bits = fine ? 8 : 7, end = 1 << (2 * bits);
    for (const each of Object.values(sums)) each.fill(0, 0, end);
    for (let i = 0; i < count; i++) {
      if (takes !== null && takes[i] === 0) continue;
      const pair = ((a[i] >> shift) << bits) | (b[i] >> shift);
      sums.all[pair]++;
      if (feasible[i] === 1) {
        sums.good[pair]++;
        sums.tint[pair] += tints[i];
      }
    }
    let n = 0;
    for (let pair = 0; pair < end; pair++) {
      if (sums.all[pair] === 0) continue;
      used.from[n] = (pair >> bits) + 0.5;
      used.rise[n] = (pair & ((1 << bits) - 1)) - (pair >> bits);
      used.all[n] = sums.all[pair];
      used.good[n] = sums.good[pair];
      used.tint[n] = sums.tint[pair];
      n++;
    }
    return n;
  }

  function density(context, takes, faint, count) {
    // Of very many rows half the heights and half the widths tell as much, from a quarter of the pairs.
    const fine = count < 8000, heights = fine ? LEVELS : LEVELS / 2;
    const across = Math.max(2, Math.ceil(gap / Math.max(fine ? 1 : 2, Math.round(gap / 110))));
    const all = new Float32Array(heights), good = new Float32Array(heights), tint = new Float32Array(heights);
    const grey = ink().dead.match(/[0-9a-f]{2}/gi).map((digits) => parseInt(digits, 16));
    scratch.width = across;
    scratch.height = heights;
    const paper = scratch.getContext("2d", { willReadFrequently: true });
    const image = paper.createImageData(across, heights), words = new Uint32Array(image.data.buffer);
    const full = Math.log1p(count / 12);
    for (let k = 0; k + 1 < axes.length; k++) {
      const n = gather(axes[k].levels, axes[k + 1].levels, takes, fine), { from, rise } = used;
      for (let x = 0; x < across; x++) {
        const share = (x + 0.5) / across;
        all.fill(0);
        good.fill(0);
        tint.fill(0);
        if (faint) {
          for (let p = 0; p < n; p++) all[(from[p] + rise[p] * share) | 0] += used.all[p];
        } else {
          for (let p = 0; p < n; p++) {
            const y = (from[p] + rise[p] * share) | 0;
            all[y] += used.all[p];
            good[y] += used.good[p];
            tint[y] += used.tint[p];
          }
        }
        for (let y = 0; y < heights; y++) words[y * across + x] = pixel(all[y], good[y], tint[y], grey, faint, full);
      }
      paper.putImageData(image, 0, 0);
      context.drawImage(scratch, left(k), TOP, gap, HEIGHT);
    }
  }

  // A colour as four bytes, the more opaque the more rows pass; grey as far as they break a limit.
  function pixel(all, good, tint, grey, faint, full) {
    if (all === 0) return 0;
    const opacity = Math.min(1, (faint ? 0.05 : 0.1) + ((faint ? 0.35 : 0.9) * Math.log1p(all)) / full);
    let red = grey[0], green = grey[1], blue = grey[2];
    if (!faint && good > 0) {
      const mix = Math.sqrt(good / all), color = RAMP[Math.round(tint / good)];
      red += mix * (color[0] - red);
      green += mix * (color[1] - green);
      blue += mix * (color[2] - blue);
    }
    return (((255 * opacity) << 24) | (blue << 16) | (green << 8) | red) >>> 0;
  }

  function overlay() {
    const context = canvases[2].getContext("2d"), colors = ink(), scale = HEIGHT / LEVELS;
    context.clearRect(0, 0, width, TOP + HEIGHT + BOTTOM);
    context.font = "11px system-ui, sans-serif";
    axes.forEach((one, k) => {
      const x = left(k), foot = TOP + HIGHEST * scale;
      context.strokeStyle = colors.soft;
      context.lineWidth = 1;
      context.beginPath();
      context.moveTo(x, TOP);
      context.lineTo(x, foot);
      context.stroke();
      const last = k === axes.length - 1;
      context.textAlign = last && k > 0 ? "right" : "left";
      for (const value of ticks(one)) {
        const y = TOP + place(one, value) * scale, words = short(value), wide = context.measureText(words).width;
        context.fillStyle = colors.page;
        context.globalAlpha = 0.75;
        context.fillRect(last && k > 0 ? x - 6 - wide : x + 4, y - 6, wide + 3, 13);
        context.globalAlpha = 1;
        context.fillStyle = colors.text;
        context.fillText(words, last && k > 0 ? x - 5 : x + 5, y + 4);
      }
      const limit = state.limits.get(one.each.name);
      if (limit !== undefined && limit >= one.low && limit <= one.high) {
        context.strokeStyle = colors.bad;
        context.lineWidth = 2;
        const y = TOP + place(one, limit) * scale;
        context.beginPath();
        context.moveTo(x - 9, y);
        context.lineTo(x + 9, y);
        context.stroke();
      }
      const range = state.ranges.get(one.each.name);
      if (range) {
        const top = TOP + place(one, Math.min(range[1], one.high)) * scale, bottom = TOP + place(one, Math.max(range[0], one.low)) * scale;
        context.fillStyle = colors.accent;
        context.globalAlpha = 0.25;
        context.fillRect(x - 8, top, 16, Math.max(2, bottom - top));
        context.globalAlpha = 1;
        context.strokeStyle = colors.accent;
        context.lineWidth = 1.5;
        context.strokeRect(x - 8, top, 16, Math.max(2, bottom - top));
      }
    });
    if (state.chosen >= 0) {
      context.strokeStyle = colors.bad;
      context.lineWidth = 2.5;
      context.beginPath();
      axes.forEach((one, k) => context[k ? "lineTo" : "moveTo"](left(k), TOP + one.levels[state.chosen] * scale));
      context.stroke();
    }
  }

  function ticks(one) {
    if (!(one.high > one.low)) return [one.low];
    if (!one.log) {
      const even = Array.from({ length: 5 }, (_, i) => one.low + (i / 4) * (one.high - one.low));
      return one.each.whole ? [...new Set(even.map(Math.round))] : even;
    }
    const decades = Math.log10(one.high / one.low), found = [one.low];
    const every = Math.max(1, Math.ceil(decades / 6));
    for (let d = Math.ceil(Math.log10(one.low) + 0.15); d <= Math.log10(one.high) - 0.15; d += every) found.push(Math.pow(10, d));
    if (found.length < 2 && decades >= 0.3) found.push(Math.sqrt(one.low * one.high));
    return [...found, one.high];
  }

  function draw() {
    paint(canvases[1], state.alive, false);
    overlay();
  }

  state.on(["filter"], draw);
  state.on(["chosen"], overlay);
  state.on(["feasible"], () => {
    axes.forEach(measureAxis);
    colour();
    paint(canvases[0], null, true);
  });
  recoloured(layout);
  addEventListener("resize", layout);
  colour();
  layout();
}
