// The picture and the controls of mireach.lab.DisturbanceLab, an anywidget module without dependencies.
//
// The page asks for one look at a time: while an answer is on its way, only the newest request is kept. Everything that
// needs no new set (which set is marked, zoom, play) stays in the browser.

const SIZE = 520; // of the picture, in CSS pixels
const EDGE = { left: 42, right: 8, top: 8, bottom: 34 };
const CHART = { width: 340, height: 132, left: 40, right: 10, top: 18, bottom: 30 };
const IDLE = 200; // ms without a wish before the largest disturbance is looked for
const PLAY = 300; // ms per set
const OWN_KEYS = ["data-lm-suppress-shortcuts", "true"]; // else JupyterLab takes the arrow keys
const ZOOMS = { state: "all of X", safe: "the safe set", terminal: "the terminal set" };

function render({ model, el }) {
  const lab = build(model.get("controls"), model.get("about"));
  lab.root.dataset.subject = model.get("name");
  lab.root.setAttribute("aria-label", `Disturbance lab of ${model.get("name")}`);
  el.classList.add("mireach-lab");
  el.append(lab.root);
  const inputs = lab.inputs;
  let settings = { ...model.get("settings") };
  let stamp = 0, busy = false, wish = false, idle = null, player = null;
  let zoom = "state", index = Infinity, bounds = null;

  // -- talking to the kernel: the newest wish wins ---------------------------------------------------

  function ask() {
    clearTimeout(idle);
    wish = true;
    lab.root.dataset.busy = "true";
    if (!busy) send();
  }

  function send() {
    wish = false;
    busy = true;
    stamp = Math.max(stamp, model.get("picture").stamp || 0) + 1;
    model.send({ do: "look", settings, stamp });
  }

  function rest() {
    clearTimeout(idle);
    const work = lab.layer.checked && !layer() ? "layer" : model.get("curve").done ? null : "idle";
    if (work) idle = setTimeout(() => busy || model.send({ do: work }), IDLE);
  }

  function layer() {
    // the maximal safe set, if it is known for the present picture
    const known = model.get("layer");
    return known.number === model.get("picture").number ? known : null;
  }

  function answered() {
    const picture = model.get("picture");
    if (busy && picture.stamp >= stamp) busy = false;
    if (!busy && !wish) adopt();
    draw();
    lab.root.dataset.busy = busy || wish;
    if (!busy && wish) send();
    else rest();
  }

  function curveArrived() {
    drawChart();
    drawScene();
    if (busy || wish || model.get("curve").done) return;
    if (model.get("picture").pending) rest(); // what a look lacks waits for a pause
    else model.send({ do: "idle" });
  }

  function layerArrived() {
    drawFacts();
    drawScene();
    rest();
  }

  function adopt() {
    settings = { ...model.get("settings") };
    for (const name in inputs) inputs[name].show(settings[name]);
  }

  // -- controls --------------------------------------------------------------------------------------

  function set(name, value) {
    inputs[name].show(value, true);
    if (settings[name] === value) return;
    settings = { ...settings, [name]: value };
    ask();
  }

  for (const name in inputs) inputs[name].listen((value) => set(name, value));

  lab.step.addEventListener("input", () => mark(Number(lab.step.value)));
  lab.play.addEventListener("click", () => {
    if (player) return stop();
    lab.play.textContent = "❚❚ pause";
    lab.play.setAttribute("aria-pressed", "true");
    const last = model.get("picture").sequence.length - 1;
    if (index >= last) mark(0);
    player = setInterval(() => {
      const end = model.get("picture").sequence.length - 1;
      if (index >= end) stop();
      else mark(index + 1);
    }, PLAY);
  });
  lab.zoom.addEventListener("change", () => {
    zoom = lab.zoom.value;
    drawScene();
  });
  lab.layer.addEventListener("change", layerArrived);
  for (const kind in lab.save) lab.save[kind].addEventListener("click", () => model.send({ do: "save", kind }));

  function stop() {
    clearInterval(player);
    player = null;
    lab.play.textContent = "▶ play";
    lab.play.setAttribute("aria-pressed", "false");
  }

  function mark(k) {
    const last = model.get("picture").sequence.length - 1;
    index = k >= last ? Infinity : k;
    drawScene();
  }

  // -- drawing ---------------------------------------------------------------------------------------

  function draw() {
    const picture = model.get("picture");
    if (picture.error) {
      lab.verdict.textContent = picture.error;
      lab.verdict.className = "verdict failed";
      return;
    }
    lab.verdict.textContent = picture.verdict;
    lab.verdict.className = picture.safe ? "verdict proven" : "verdict failed";
    drawFacts();
    drawScene();
    drawChart();
    lab.root.dataset.stamp = picture.stamp;
  }

  function drawFacts() {
    const facts = [...(model.get("picture").facts || [])];
    if (lab.layer.checked) facts.push(["maximal safe set", layer() ? layer().text : "…"]);
    lab.facts.replaceChildren(...facts.flatMap(([name, value]) => [node("dt", {}, name), node("dd", {}, value)]));
  }

  function drawScene() {
    const picture = model.get("picture");
    if (!picture.sequence) return;
    const sequence = picture.sequence;
    const k = Math.min(index, sequence.length - 1);
    lab.step.max = sequence.length - 1;
    lab.step.value = k;
    const chosen = sequence[k];
    lab.stepName.textContent = `${chosen.name}${subscript(chosen.k)} (${k + 1} of ${sequence.length})`;
    lab.step.setAttribute("aria-valuetext", `${chosen.name} ${chosen.k}`);
    const scene = lab.scene;
    const seen = (points) => Boolean(points && points.length); // a section may miss a set
    for (const option of lab.zoom.options) option.disabled = !seen(picture[option.value]);
    if (!seen(picture[zoom])) zoom = lab.zoom.value = "state";
    bounds = frame(zoom === "state" ? [...picture.state, ...(picture.witness || [])] : picture[zoom]);
    const place = ([x, y]) => [bounds.x(x), bounds.y(y)];
    const path = (points, closed) =>
      points.length && "M" + points.map((p) => place(p).map((c) => c.toFixed(2)).join(",")).join("L") + (closed ? "Z" : "");
    const shape = (points, name) => draft("path", { d: path(points, points.length > 2) || "", class: name });
    const line = (points, name) => draft("path", { d: path(points, false), class: `line ${name}` });
    const parts = picture.regions.map((points) => shape(points, "region"));
    parts.push(shape(picture.state, "state"));
    const rings = lab.layer.checked && layer() ? layer().rings : [];
    if (rings.length) parts.push(draft("path", { d: rings.map((ring) => path(ring, true)).join(""), class: "maximal" }));
    if (picture.safe) parts.push(shape(picture.safe, "safe"));
    for (const one of sequence) parts.push(shape(one.points, one.name === "F" ? "earlier" : "reach"));
    const curve = model.get("curve");
    if (!picture.safe && curve.largest_set) parts.push(shape(curve.largest_set, "largest"));
    for (const trajectory of picture.disturbed) parts.push(line(trajectory, "disturbed"));
    if (picture.terminal) parts.push(shape(picture.terminal, "terminal"));
    if (index < sequence.length - 1) parts.push(shape(chosen.points, "chosen"));
    if (picture.plant) parts.push(line(picture.plant, "plant"));
    parts.push(line(picture.nominal, "nominal"));
    for (const [x, y] of picture.nominal) parts.push(dot(place([x, y]), 1.8, "nominal-state"));
    if (picture.witness) {
      parts.push(line(picture.witness, "witness"));
      parts.push(dot(place(picture.witness[0]), 3, "witness-state"), cross(...place(picture.witness[1]), "left", 5));
    }
    const [cx, cy] = place(picture.centre);
    parts.push(draft("path", { d: `M${cx - 5},${cy}H${cx + 5}M${cx},${cy - 5}V${cy + 5}`, class: "centre" }));
    scene.marks.replaceChildren(...parts);
    scene.axes.replaceChildren(...axes(bounds, picture.axes.map(([, name]) => name)));
    lab.caption.textContent = picture.caption;
    placeStart();
    scene.svg.setAttribute("aria-label", `${picture.caption || "The plane of states."} ${picture.verdict}. Marked set: ${chosen.name} ${chosen.k}.`);
    lab.root.dataset.chosen = `${chosen.name}${chosen.k}`;
    lab.root.dataset.pending = picture.pending;
    for (const [name, item] of Object.entries(lab.legend)) item.hidden = !shown(name, picture, curve, rings);
  }

  function drawnNames() {
    // the names of the two settings that the picture shows of the initial state
    return model.get("picture").axes.map(([axis]) => `x${axis + 1}`);
  }

  function placeStart() {
    // where the initial state is, or at the edge of the picture nearest to it
    const [x, y] = drawnNames().map((name) => settings[name]), clamp = (value, low, high) => Math.min(Math.max(value, low), high);
    const start = lab.scene.start;
    start.setAttribute("cx", clamp(bounds.x(x), EDGE.left, SIZE - EDGE.right));
    start.setAttribute("cy", clamp(bounds.y(y), EDGE.top, SIZE - EDGE.bottom));
    start.setAttribute("aria-valuenow", x);
    const states = Object.keys(settings).filter((name) => /^x\d+$/.test(name));
    start.setAttribute("aria-valuetext", states.map((name) => `${name} = ${settings[name]}`).join(", "));
  }

  function drawChart() {
    const curve = model.get("curve"), control = inputs.amount.control;
    const points = curve.points || [];
    const top = 1.08 * Math.max(1e-9, ...points.map(([, area]) => area || 0));
    const { width, height, left, right, top: above, bottom } = CHART;
    const x = (amount) => left + ((amount - control.low) / (control.high - control.low)) * (width - left - right);
    const y = (area) => height - bottom - (area / top) * (height - above - bottom);
    const base = height - bottom;
    const parts = [draft("path", { d: `M${left},${above}V${base}H${width - right}`, class: "axis" })];
    for (const value of ticks(control.low, control.high, 5)) {
      parts.push(draft("path", { d: `M${x(value)},${base}v4`, class: "axis" }));
      parts.push(words(x(value), base + 15, number(value), "middle"));
    }
    if (points.some(([, area]) => area)) for (const value of ticks(0, top, 3)) parts.push(words(left - 5, y(value) + 4, number(value), "end"));
    const proven = points.filter(([, area]) => area !== null);
    if (proven.length)
      parts.push(draft("path", { d: "M" + proven.map(([a, area]) => `${x(a).toFixed(1)},${y(area).toFixed(1)}`).join("L"), class: "area" }));
    for (const [amount, area] of points)
      parts.push(area === null ? cross(x(amount), base, "none") : dot([x(amount), y(area)], 2.4, "area-point"));
    if (curve.largest !== null && curve.largest !== undefined) {
      parts.push(draft("path", { d: `M${x(curve.largest)},${above}V${base}`, class: "largest" }));
      const near = x(curve.largest) > width - 110;
      const name = curve.largest >= control.high ? "at least" : curve.settled ? "largest" : "largest so far";
      const text = `${name} ${curve.largest.toFixed(4)}`;
      parts.push(words(x(curve.largest) + (near ? -4 : 4), above + 2, text, near ? "end" : "start"));
    } else if (curve.settled) parts.push(words(width / 2, above + 30, "no F_max for any amount tried", "middle"));
    parts.push(draft("path", { d: `M${x(settings.amount)},${above}V${base}`, class: "now" }));
    lab.chart.replaceChildren(...parts);
    lab.chart.setAttribute("aria-label", curve.summary || `${model.get("about").size} of F_max over the disturbance: not computed yet.`);
    lab.root.dataset.largest = curve.settled ? curve.largest : "";
  }

  // -- the initial state, by hand --------------------------------------------------------------------

  function move(x, y) {
    const clip = (value, control) => Math.min(Math.max(value, control.low), control.high);
    const names = drawnNames();
    [x, y].forEach((value, i) => {
      const moved = clip(Math.round(value * 100) / 100, inputs[names[i]].control);
      settings = { ...settings, [names[i]]: moved };
      inputs[names[i]].show(moved);
    });
    placeStart();
    ask();
  }

  const handle = lab.scene.start;
  handle.addEventListener("pointerdown", (event) => {
    handle.setPointerCapture(event.pointerId);
    handle.focus();
    event.preventDefault();
  });
  handle.addEventListener("pointermove", (event) => {
    if (!handle.hasPointerCapture(event.pointerId)) return;
    const box = lab.scene.svg.getBoundingClientRect(), scale = SIZE / box.width;
    move(bounds.left((event.clientX - box.left) * scale), bounds.up((event.clientY - box.top) * scale));
  });
  handle.addEventListener("keydown", (event) => {
    const way = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] }[event.key];
    if (!way) return;
    event.preventDefault();
    event.stopPropagation();
    const [x, y] = drawnNames(), reach = (event.shiftKey ? 10 : 1) * inputs[x].control.step;
    move(settings[x] + way[0] * reach, settings[y] + way[1] * reach);
  });

  // -- files -----------------------------------------------------------------------------------------

  function download(message) {
    if (!message.file) return;
    const link = node("a", { href: URL.createObjectURL(new Blob([message.text], { type: message.type })), download: message.file });
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 10000);
  }

  function settingsArrived() {
    if (!busy && !wish) adopt();
  }

  model.on("change:settings", settingsArrived);
  model.on("change:picture", answered);
  model.on("change:curve", curveArrived);
  model.on("change:layer", layerArrived);
  model.on("msg:custom", download);
  adopt();
  draw();
  rest();
  return () => {
    clearInterval(player);
    clearTimeout(idle);
    model.off("change:settings", settingsArrived);
    model.off("change:picture", answered);
    model.off("change:curve", curveArrived);
    model.off("change:layer", layerArrived);
    model.off("msg:custom", download);
  };
}

// -- the page ----------------------------------------------------------------------------------------

let pages = 0;

function build(controls, about) {
  const page = `mireach-lab-${Date.now().toString(36)}-${pages++}`;
  const inputs = {}, rows = [];
  for (const control of controls) {
    const id = `${page}-${control.name}`;
    const input = control.choices ? choice(control, id) : numeric(control, id);
    inputs[control.name] = input;
    rows.push(node("label", { for: id }, control.label), node("div", { class: "inputs" }, ...input.elements));
  }

  const scene = {
    svg: draft("svg", { viewBox: `0 0 ${SIZE} ${SIZE}`, class: "scene", role: "group" }),
    axes: draft("g", { class: "axes" }),
    marks: draft("g", { "clip-path": `url(#${page}-frame)` }),
    start: draft("circle", {
      r: 8, class: "start", tabindex: 0, role: "slider", "aria-label": "Initial state: drag it, or use the arrow keys",
      [OWN_KEYS[0]]: OWN_KEYS[1],
    }),
  };
  const frameBox = { x: EDGE.left, y: EDGE.top, width: SIZE - EDGE.left - EDGE.right, height: SIZE - EDGE.top - EDGE.bottom };
  const hatch = draft("pattern", { id: `${page}-hatch`, width: 6, height: 6, patternUnits: "userSpaceOnUse", patternTransform: "rotate(45)" });
  hatch.append(draft("path", { d: "M0,0V6", class: "hatch" }));
  const clip = draft("clipPath", { id: `${page}-frame` });
  clip.append(draft("rect", frameBox));
  const definitions = draft("defs");
  definitions.append(hatch, clip);
  scene.svg.append(definitions, scene.axes, scene.marks, scene.start);
  scene.svg.style.setProperty("--hatch", `url(#${page}-hatch)`);

  const step = node("input", { type: "range", id: `${page}-step`, min: 0, max: 0, step: 1 });
  const stepName = node("output", { for: `${page}-step`, class: "step-name" });
  const play = node("button", { type: "button", "aria-pressed": "false" }, "▶ play");
  const zoom = node("select", { id: `${page}-zoom` }, ...Object.entries(ZOOMS).map(([value, text]) => node("option", { value }, text)));
  const layer = node("input", { type: "checkbox", id: `${page}-layer` });
  const timeline = node("div", { class: "timeline" }, play, node("label", { for: `${page}-step` }, "set"), step, stepName,
    node("label", { for: `${page}-zoom` }, "show"), zoom);
  if (about.maximal)
    timeline.append(node("span", {}, layer, node("label", { for: `${page}-layer` }, "with the maximal safe set, without a template")));

  const legend = {
    maximal: "maximal safe set", safe: "F_max", earlier: "F_k", reach: "R_k", terminal: "terminal set", chosen: "marked set", disturbed: "disturbed",
    nominal: "nominal", plant: "the plant itself", witness: "a step that leaves X", largest: "F_max at the largest disturbance",
    centre: "centre of the stopping rule",
  };
  const items = {};
  for (const [name, text] of Object.entries(legend)) {
    const swatch = draft("svg", { viewBox: "0 0 26 12", width: 26, height: 12, "aria-hidden": "true" });
    swatch.append(name === "centre" ? draft("path", { d: "M8,6H18M13,1V11", class: "centre" })
      : ["disturbed", "nominal", "plant", "witness"].includes(name) ? draft("path", { d: "M1,6H25", class: `line ${name}` })
      : draft("rect", { x: 1, y: 1, width: 24, height: 10, class: name }));
    const [, base, lower, rest] = text.match(/^(\w)_(\w+)(.*)$/) || [];
    const parts = base ? [node("i", {}, base, node("sub", {}, lower)), rest] : [text];
    items[name] = node("span", { class: "item" }, swatch, node("span", {}, ...parts));
  }

  const caption = node("p", { class: "caption view" });
  const verdict = node("p", { class: "verdict", role: "status", "aria-live": "polite" });
  const facts = node("dl", { class: "facts" });
  const chart = draft("svg", { viewBox: `0 0 ${CHART.width} ${CHART.height}`, class: "chart", role: "img" });
  const save = {
    figure: node("button", { type: "button" }, "Figure (SVG)"),
    sets: node("button", { type: "button" }, "Sets (JSON)"),
    script: node("button", { type: "button" }, "Python"),
  };
  const amount = controls.find((control) => control.name === "amount");
  const root = node("div", { class: "columns", role: "group" },
    node("div", { class: "left" }, verdict, scene.svg, timeline, node("div", { class: "legend" }, ...Object.values(items)), caption),
    node("div", { class: "right" },
      node("div", { class: "controls" }, ...rows),
      facts,
      node("p", { class: "caption" }, `${about.size} of F_max${power(about)} over “${amount.label}”${unit(amount)}; ✕: none found`),
      chart,
      node("div", { class: "save" }, node("span", {}, "Save:"), ...Object.values(save))));
  return { root, inputs, scene, step, stepName, play, zoom, layer, legend: items, caption, verdict, facts, chart, save };
}

function numeric(control, id) {
  const range = { min: control.low, max: control.high, step: control.step };
  const box = node("input", { type: "number", id, ...range });
  const slider = control.slider ? node("input", { type: "range", "aria-label": control.label, ...range }) : null;
  const settle = (text) => Math.min(Math.max(Number(text), control.low), control.high);
  let shown = "";
  return {
    control,
    elements: [...(slider ? [slider] : []), box, ...(control.unit ? [node("span", {}, control.unit)] : [])],
    show(value, own = false) {
      shown = String(Math.round(value * 1e6) / 1e6);
      if (slider) slider.value = shown;
      if (own || document.activeElement !== box) box.value = shown; // else somebody is typing
    },
    listen(act) {
      if (slider) slider.addEventListener("input", () => act(settle(slider.value)));
      const read = () => (box.value !== "" && Number.isFinite(Number(box.value)) ? act(settle(box.value)) : (box.value = shown));
      box.addEventListener("change", read);
      box.addEventListener("keydown", (event) => event.key === "Enter" && read()); // JupyterLab keeps the default away
    },
  };
}

function choice(control, id) {
  const select = node("select", { id }, ...Object.entries(control.choices).map(([value, text]) => node("option", { value }, text)));
  return {
    control,
    elements: [select],
    show(value) { select.value = value; },
    listen(act) { select.addEventListener("change", () => act(select.value)); },
  };
}

function shown(name, picture, curve, rings) {
  const there = {
    maximal: rings.length,
    safe: picture.safe?.length, terminal: picture.terminal?.length, reach: picture.terminal, plant: picture.plant, witness: picture.witness,
    largest: !picture.safe && curve.largest_set,
  };
  return name in there ? Boolean(there[name]) : true;
}

function unit(control) {
  return control.unit ? ` (${control.unit})` : "";
}

function power({ unit, n }) {
  // the unit of a size in R^n
  return unit ? ` (${unit}${{ 2: "²", 3: "³" }[n] || `^${n}`})` : "";
}

// -- small things ------------------------------------------------------------------------------------

function node(tag, attributes = {}, ...children) {
  const made = document.createElement(tag);
  if (["input", "select", "button"].includes(tag)) made.setAttribute(...OWN_KEYS);
  for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
  made.append(...children);
  return made;
}

function draft(tag, attributes = {}) {
  const made = document.createElementNS("http://www.w3.org/2000/svg", tag);
  for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
  return made;
}

function words(x, y, text, anchor) {
  const made = draft("text", { x, y, "text-anchor": anchor });
  made.textContent = text;
  return made;
}

function dot([x, y], r, name) {
  return draft("circle", { cx: x.toFixed(2), cy: y.toFixed(2), r, class: name });
}

function cross(x, y, name, r = 3) {
  return draft("path", { d: `M${x - r},${y - r}L${x + r},${y + r}M${x - r},${y + r}L${x + r},${y - r}`, class: name });
}

function frame(points) {
  // the map from states to pixels that shows all of `points` with equal scales
  const xs = points.map((p) => p[0]), ys = points.map((p) => p[1]);
  const middle = [(Math.min(...xs) + Math.max(...xs)) / 2, (Math.min(...ys) + Math.max(...ys)) / 2];
  const span = 1.12 * Math.max(Math.max(...xs) - Math.min(...xs), Math.max(...ys) - Math.min(...ys), 1e-6);
  const side = SIZE - EDGE.left - EDGE.right;
  const scale = side / span;
  const x0 = EDGE.left + side / 2, y0 = EDGE.top + (SIZE - EDGE.top - EDGE.bottom) / 2;
  return {
    x: (x) => x0 + (x - middle[0]) * scale,
    y: (y) => y0 - (y - middle[1]) * scale,
    left: (px) => middle[0] + (px - x0) / scale,
    up: (py) => middle[1] - (py - y0) / scale,
  };
}

function axes(bounds, names) {
  const right = SIZE - EDGE.right, bottom = SIZE - EDGE.bottom;
  const parts = [draft("rect", { x: EDGE.left, y: EDGE.top, width: right - EDGE.left, height: bottom - EDGE.top, class: "axis" })];
  for (const value of ticks(bounds.left(EDGE.left), bounds.left(right), 7)) {
    parts.push(draft("path", { d: `M${bounds.x(value)},${bottom}v4`, class: "axis" }));
    parts.push(words(bounds.x(value), bottom + 16, number(value), "middle"));
  }
  for (const value of ticks(bounds.up(bottom), bounds.up(EDGE.top), 7)) {
    parts.push(draft("path", { d: `M${EDGE.left},${bounds.y(value)}h-4`, class: "axis" }));
    parts.push(words(EDGE.left - 7, bounds.y(value) + 4, number(value), "end"));
  }
  parts.push(words((EDGE.left + right) / 2, SIZE - 3, names[0], "middle"));
  const name = words(10, (EDGE.top + bottom) / 2, names[1], "middle");
  if (names[1].length > 2) name.setAttribute("transform", `rotate(-90 10 ${(EDGE.top + bottom) / 2})`);
  parts.push(name);
  return parts;
}

function ticks(low, high, count) {
  const raw = (high - low) / count, power = 10 ** Math.floor(Math.log10(raw));
  const step = [1, 2, 5, 10].map((m) => m * power).find((s) => s >= raw);
  const found = [];
  for (let k = Math.ceil(low / step); k * step <= high + 1e-9 * step; k++) found.push(k * step);
  return found;
}

function number(value) {
  return String(Number(value.toPrecision(6))).replace("-", "−");
}

function subscript(k) {
  return String(k).replace(/\d/g, (digit) => "₀₁₂₃₄₅₆₇₈₉"[digit]);
}

export default { render };
