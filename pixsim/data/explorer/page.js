// The page of `pixsim explore`: it shows what is computed, and asks for the last settings only.
const at = id => document.getElementById(id), make = (tag, more = {}) => Object.assign(document.createElement(tag), more);
const NAMES = ["A", "B"], SLIDER = 1000, REACH = 10, FULL_RANGE = 1000, round = value => Number(Number(value).toPrecision(4));
const token = location.hash.slice(1) || sessionStorage.getItem("token");
sessionStorage.setItem("token", token ?? "");  // for a page that is loaded again
history.replaceState(null, "", location.pathname);

let hello, number = 0, which = 0, asking = 0;
const sensors = [{preset: 0, set: {}}, {preset: 0, set: {}}], seen = [{}, {}], points = [[], []], fields = {};
const count = () => at("two").checked ? 2 : 1;
const setOf = control => sensors[control.is_shared ? 0 : which].set;

const socket = new WebSocket(`ws://${location.host}/socket`);
socket.onopen = () => socket.send(JSON.stringify({token}));
socket.onmessage = event => received(JSON.parse(event.data));
socket.onclose = event => {
  at("state").textContent = {4403: "This page has no valid token: open the file that pixsim named.", 4409: "Another page took over."}[event.code]
    ?? "pixsim has ended.";
  at("stack").classList.add("old");
};

function received(message) {
  if (message.hello) return begin(message.hello);
  if (message.number !== undefined && message.number !== number) return;  // of older settings
  if (message.error) {
    complain(message.error);
    at("state").textContent = "These settings are not possible; the picture is that of the last possible ones.";
  } else if (message.busy) at("state").textContent = message.busy;
  else if (message.point) { points[message.sensor].push(message.point); draw(); }
  else if (message.done) at("state").textContent = "done";
  else { seen[message.sensor] = {...seen[message.sensor], command: "", ...message}; show(); }
}

function complain(words) { at("error").textContent = words; at("error").hidden = false; at("stack").classList.add("old"); }

function begin(found) {
  hello = found; at("title").textContent = hello.title; document.title = `pixsim explore: ${hello.title}`;
  const groups = {};
  hello.presets.forEach((preset, index) => {
    groups[preset.group] ??= at("preset").appendChild(make("optgroup", {label: preset.group}));
    groups[preset.group].append(make("option", {value: index, textContent: preset.name}));
  });
  for (const [value, words] of Object.entries(hello.metrics)) {
    const label = at("metrics").appendChild(make("label", {className: "row"}));
    label.append(make("input", {type: "checkbox", value, onchange: ask}), `${value}: ${words}`);
  }
  hello.controls.forEach(addControl);
  fillPictures(); ask();
}

function addControl(control) {
  const id = control.path, words = control.label + (control.unit ? ` (${control.unit})` : "");
  const label = make("label", {htmlFor: id, textContent: words}), reset = make("button", {type: "button", textContent: "reset"});
  reset.setAttribute("aria-label", `reset ${control.label}`);
  const isChoice = control.choices.length > 0, slider = isChoice ? null : make("input", {type: "range", min: 0, max: SLIDER});
  const field = isChoice ? make("select", {id})
    : make("input", {id, type: "number", step: "any", min: control.minimum ?? "", max: control.maximum ?? ""});
  control.choices.forEach(each => field.append(make("option", {textContent: each})));
  slider?.setAttribute("aria-label", `${words}, slider`);
  const turn = value => { setOf(control)[id] = value; mark(control); ask(); };
  field.onchange = () => {
    if (isChoice) return turn(field.value);
    if (field.value !== "" && field.checkValidity()) return turn(Number(field.value));
    complain(`${control.label}: ${field.validationMessage || "a number is missing"}`);
  };
  const slide = () => { field.value = round(scaled(fields[id].range, slider.value / SLIDER)); speak(control, field.value); };
  if (slider) slider.oninput = () => { slide(); turn(Number(field.value)); };
  reset.onclick = () => { delete setOf(control)[id]; fields[id].range = undefined; mark(control); ask(); };
  const help = make("small", {id: `${id}-help`, textContent: control.help}), box = make("div", {className: "control"});
  field.setAttribute("aria-describedby", help.id); at("controls").append(box);
  box.append(label, ...(slider ? [slider] : []), field, reset, help);
  fields[id] = {control, field, slider, label};
}

// A slider reaches from a part of its first value to a multiple, within the bounds; where these are near, it has all between them.
function rangeOf(control, value) {
  const low = control.minimum ?? -Infinity, high = control.maximum ?? Infinity;
  if (high - low <= FULL_RANGE) return {low, high, even: true};
  if (control.pair || !(value > 0)) return {low: control.pair ? -1000 : 0, high: control.pair ? 1000 : 100, even: true};
  return {low: Math.max(low, value / REACH), high: Math.min(high, value * REACH), even: false};
}
const scaled = ({low, high, even}, share) => even ? low + share * (high - low) : low * (high / low) ** share;
const shareOf = ({low, high, even}, value) => even ? (value - low) / (high - low) : Math.log(value / low) / Math.log(high / low);
const speak = (control, value) => fields[control.path].slider?.setAttribute("aria-valuetext", `${value} ${control.unit}`);
const mark = control => fields[control.path].label.classList.toggle("changed", control.path in setOf(control));

function showValues() {
  for (const entry of Object.values(fields)) {
    const {control, field, slider} = entry, value = setOf(control)[control.path] ?? seen[which].values?.[control.path];
    mark(control);
    if (document.activeElement === field) continue;  // it is being typed
    if (control.choices.length) { field.value = value; continue; }
    field.value = value === null || value === undefined ? "" : control.path in setOf(control) ? value : round(value);
    if (!slider || document.activeElement === slider && entry.range) continue;
    const number = Number(field.value), range = entry.range;
    if (!range || number < range.low || number > range.high) entry.range = rangeOf(control, number);
    slider.value = SLIDER * shareOf(entry.range, number);
    speak(control, field.value);
  }
}

// One request an animation frame: what a slider passed meanwhile is nobody's question.
function ask() {
  if (!asking) asking = requestAnimationFrame(() => {
    asking = 0; number += 1; points.forEach(each => each.length = 0); draw();
    at("error").hidden = true; at("state").textContent = "computing …"; at("stack").classList.add("old");
    const metrics = [...at("metrics").querySelectorAll(":checked")].map(each => each.value);
    if (socket.readyState === WebSocket.OPEN)
      socket.send(JSON.stringify({number, sensors: sensors.slice(0, count()), metrics, curve: at("curve").checked}));
  });
}

const PICTURES = {ideal: "ideal picture", image: "sensor's picture", delta_e: "ΔE map"};
function fillPictures() {
  for (const [side, chosen] of [["left", count() > 1 ? "0 image" : "0 ideal"], ["right", count() > 1 ? "1 image" : "0 image"]]) {
    at(side).replaceChildren(...NAMES.slice(0, count()).flatMap((own, index) => Object.entries(PICTURES).map(([name, words]) =>
      make("option", {value: `${index} ${name}`, textContent: count() > 1 ? `${words}, ${own}` : words}))));
    at(side).value = chosen;
  }
}

function show() {
  const shown = seen.slice(0, count()), most = Math.max(...shown.map(each => each.dots?.[1] ?? 0));
  const [size, unit] = at("whole").checked ? [devicePixelRatio, "px"] : [most / 100, "%"];
  for (const [side, image] of [["left", at("over")], ["right", at("under")]]) {
    const [index, name] = at(side).value.split(" "), found = seen[index];
    if (!found.pictures) continue;
    image.src = found.pictures[name];
    image.alt = `${PICTURES[name]}${count() > 1 ? `, sensor ${NAMES[index]}` : ""}, ${found.lines[0]}`;
    // A sensor of larger pixels has a wider border that is not shown: dots stay in their place.
    Object.assign(image.style, {width: `${found.dots[1] / size}${unit}`, margin: `${(most - found.dots[1]) / 2 / size}${unit}`});
  }
  at("stack").classList.toggle("whole", at("whole").checked);
  at("stack").classList.toggle("old", shown.some(each => each.number !== number));
  at("over").style.clipPath = `inset(0 ${100 - at("wipe").value}% 0 0)`;
  at("wipe").setAttribute("aria-valuetext", `${at("wipe").value} % of the width is the left picture`);
  const unsure = [...new Set(shown.map(each => each.unsure).filter(Boolean))].join("; ");
  at("unsure").textContent = unsure; at("unsure").hidden = !unsure;
  at("scale").textContent = shown.filter(each => each.end).map((each, index) =>
    `${count() > 1 ? `${NAMES[index]}: ` : ""}${each.dots[1]} × ${each.dots[0]} dots; ΔE map from 0 (dark) to ${each.end} and more (yellow)`).join(". ");
  at("answers").replaceChildren(...shown.map((each, index) => {
    const box = make("div");
    if (count() > 1) box.append(make("h3", {textContent: `Sensor ${NAMES[index]}`}));
    (each.lines ?? []).forEach(line => box.append(make("p", {textContent: line})));
    return box;
  }));
  at("command").textContent = shown.map(each => each.command).filter(Boolean).join("\n");
  at("copy").disabled = at("save").disabled = !seen[which].command;
  showValues();
}

function draw() {
  const all = points.flat(), svg = at("plot").querySelector("svg"); svg.replaceChildren();
  if (at("plot").hidden = !all.length) return;
  const x = all.map(each => Math.log(each[0])), low = Math.min(...x), wide = Math.max(...x) - low || 1;
  const top = Math.max(...all.map(each => each[1] + each[2])) || 1;
  const place = ([pitch, mean]) => [40 + 340 * (Math.log(pitch) - low) / wide, 170 - 155 * Math.max(mean, 0) / top];
  const add = (parent, tag, more, words = "") => {
    const each = parent.appendChild(document.createElementNS(svg.namespaceURI, tag));
    Object.entries(more).forEach(([name, value]) => each.setAttribute(name, value));
    return each.append(words), each;
  };
  points.slice(0, count()).forEach((own, index) => {
    const group = add(svg, "g", {class: NAMES[index].toLowerCase()}), sorted = [...own].sort((one, other) => one[0] - other[0]);
    if (sorted.length > 1) add(group, "path", {d: "M" + sorted.map(each => place(each).join(" ")).join("L")});
    for (const [pitch, mean, half] of sorted) {
      const [left, high] = place([pitch, mean + half]), [, deep] = place([pitch, mean - half]);
      add(group, "line", {x1: left, x2: left, y1: high - 1, y2: deep + 1, "stroke-width": 3});
    }
  });
  for (const pitch of new Set(all.map(each => each[0]))) add(svg, "text", {x: place([pitch, 0])[0], y: 185, "text-anchor": "middle"}, pitch);
  for (const mean of [0, top]) add(svg, "text", {x: 35, y: place([1, mean])[1] + 4, "text-anchor": "end"}, Number(mean.toPrecision(2)));
  add(svg, "text", {x: 210, y: 199, "text-anchor": "middle"}, "pixel size (µm)");
  at("caption").textContent = `Mean ΔE against pixel size in µm${count() > 1 ? ": A solid, B dashed" : ""}. Bars are 95 % intervals of the mean over `
    + `${hello.sensors} sensors of each size. All sizes are in the light of the present one, whose film was not measured for them.`;
  const said = points.map((own, index) => own.map(([pitch, mean, half]) => `${NAMES[index]} ${pitch} µm ${mean.toFixed(4)} ± ${half.toFixed(4)}`));
  svg.setAttribute("aria-label", `mean ΔE: ${said.flat().join(", ")}`);
}

at("two").onchange = () => {
  sensors[1] = structuredClone(sensors[0]); seen[1] = seen[0]; which = 0;
  document.querySelector("[name=which]").checked = true; at("which").hidden = count() === 1;
  fillPictures(); ask();
};
at("which").onchange = event => { which = Number(event.target.value); at("preset").value = sensors[which].preset; forget(); show(); };
const forget = () => Object.values(fields).forEach(each => each.range = undefined);
at("preset").onchange = () => { sensors[which] = {preset: Number(at("preset").value), set: {}}; forget(); ask(); };
at("reset").onclick = () => { Object.values(fields).forEach(({control}) => delete setOf(control)[control.path]); forget(); ask(); };
at("curve").onchange = ask;
for (const id of ["left", "right", "whole", "wipe"]) at(id).oninput = show;
at("settings").onsubmit = event => event.preventDefault();
at("copy").onclick = async () => {
  await navigator.clipboard.writeText(seen[which].command);
  at("state").textContent = "The command is in the clipboard; its image.png is this picture.";
};
at("save").onclick = () => {
  const href = URL.createObjectURL(new Blob([seen[which].settings], {type: "application/toml"}));
  make("a", {href, download: "settings.toml"}).click(); URL.revokeObjectURL(href);
};
