// The map of a report: layers, probe, ruler, links between map and tables, profile. Without it the page still answers.
"use strict";

const $ = (id) => document.getElementById(id);
const data = JSON.parse($("map-data").textContent);
const at = (east, north) => L.latLng(north, east); // the map counts in metres: y is north, x is east

// ---- values as text, as in the rest of the report

const percent = (p) => p > 0.9995 ? "> 99.9 %" : p > 0 && p < 0.0005 ? "< 0.1 %" : `${p === 0 ? 0 : (100 * p).toFixed(1)} %`;
const metres = (v) => Math.abs(v) < 0.0095 ? `${(100 * v).toFixed(1)} cm`
  : Math.abs(v) < 0.995 ? `${(100 * v).toFixed(0)} cm` : `${v.toFixed(1)} m`;
const degrees = (v) => `${(v * 180 / Math.PI).toFixed(1)}°`;
const FORMS = { height: (v) => `${v.toFixed(2)} m`, length: metres, angle: degrees, chance: percent, count: String, text: String };

function element(tag, attributes = {}, ...children) {
  const made = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) name in made ? made[name] = value : made.setAttribute(name, value);
  made.append(...children);
  return made;
}

function drawn(tag, attributes, text = "") {
  const made = document.createElementNS("http://www.w3.org/2000/svg", tag);
  for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
  made.textContent = text;
  return made;
}

// ---- fields: see fields.py for their coding

async function unpack(field) {
  const packed = Uint8Array.from(atob(field.data), (c) => c.charCodeAt(0));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
  const planes = new Uint8Array(await new Response(stream).arrayBuffer());
  const size = field.rows * field.cols;
  const codes = field.bytes === 1 ? new Uint8Array(size) : new Uint16Array(size);
  for (let i = 0; i < size; i++) {
    const left = i % field.cols ? codes[i - 1] : 0;
    codes[i] = left + planes[i] + (field.bytes === 2 ? planes[size + i] << 8 : 0); // wraps as the array's type does
  }
  field.codes = codes;
  delete field.data;
}

const valueOf = (field, code) => field.values.length ? field.values[code - 1] : field.low + (code - 1) * field.step;

function valueAt(name, place) {
  const f = data.fields[name];
  if (!f || !f.codes) return null;
  const row = Math.round((f.north - place.lat) / f.cell), col = Math.round((place.lng - f.east) / f.cell);
  if (row < 0 || col < 0 || row >= f.rows || col >= f.cols) return null;
  const code = f.codes[row * f.cols + col];
  return code ? valueOf(f, code) : null;
}

function textAt(name, place) {
  const value = valueAt(name, place);
  return value === null ? null : FORMS[data.fields[name].form](value);
}

// ---- layers

const rgb = (colour) => [1, 3, 5, 7].map((i) => parseInt(colour.slice(i, i + 2) || "ff", 16));

function ramped(colours, share) {
  const t = Math.min(Math.max(share, 0), 1) * (colours.length - 1), i = Math.min(Math.floor(t), colours.length - 2);
  const [a, b] = [rgb(colours[i]), rgb(colours[i + 1])];
  return a.map((v, k) => v + (t - i) * (b[k] - v));
}

function paint(field, colours) { // the field as a canvas, one pixel a cell
  const codes = field.codes, most = codes.reduce((m, c) => c > m ? c : m, 0);
  const table = new Uint32Array(most + 1), one = new Uint8Array(table.buffer);
  for (let code = 1; code <= most; code++) {
    const share = (valueOf(field, code) - colours.low) / (colours.high - colours.low || 1);
    one.set(colours.codes.length ? rgb(colours.codes[code - 1]) : ramped(colours.ramp, share), 4 * code);
  }
  const canvas = element("canvas", { width: field.cols, height: field.rows, className: "cells" });
  canvas.getContext("2d").putImageData(
    new ImageData(new Uint8ClampedArray(Uint32Array.from(codes, (c) => table[c]).buffer), field.cols), 0, 0);
  return canvas;
}

function bounds(grid) {
  const half = grid.cell / 2;
  return L.latLngBounds(at(grid.east - half, grid.north - (grid.rows - 0.5) * grid.cell),
    at(grid.east + (grid.cols - 0.5) * grid.cell, grid.north + half));
}

function legend(layer, field) {
  const { ramp, low, high, keys, caption } = layer.colours, out = [element("p", {}, caption)];
  if (ramp.length) {
    const ends = [low, (low + high) / 2, high].map(FORMS[field.form]);
    if (field.form === "count") ends[1] = "";
    out.unshift(element("div", { className: "ramp", style: `background: linear-gradient(90deg, ${ramp})` }),
      element("div", { className: "ends" }, ...ends.map((text) => element("span", {}, text))));
  } else {
    out.unshift(element("ul", { className: "keys" }, ...keys.map((k) => element("li", {},
      element("i", { style: `background: ${k.colour}` }), k.text, element("b", {}, k.share)))));
  }
  return out;
}

function layers(map) {
  const shown = { layer: null }, fade = $("fade");
  const show = (layer) => {
    if (shown.layer) shown.layer.remove();
    shown.layer = null;
    $("legend").replaceChildren();
    fade.disabled = !layer;
    if (!layer) return;
    const field = data.fields[layer.name];
    layer.image ??= L.svgOverlay(paint(field, layer.colours), bounds(field), { pane: "layer" });
    shown.layer = layer.image.setOpacity(fade.value / 100).addTo(map);
    $("legend").replaceChildren(...legend(layer, field));
  };
  fade.addEventListener("input", () => shown.layer && shown.layer.setOpacity(fade.value / 100));
  for (const layer of [null, ...data.layers]) {
    const radio = element("input", { type: "radio", name: "layer", value: layer ? layer.name : "picture", checked: !layer });
    radio.addEventListener("change", () => show(layer));
    $("layers").append(element("label", {}, radio, layer ? data.fields[layer.name].title : "Picture only"));
  }
}

function overlay(title, layer, map, checked) {
  const box = element("input", { type: "checkbox", checked });
  box.addEventListener("change", () => box.checked ? layer.addTo(map) : layer.remove());
  if (checked) layer.addTo(map);
  $("overlays").append(element("label", {}, box, title));
}

// ---- shapes, and the numbers of sites beside their discs

function shape(s, map, group) {
  const style = { className: `shape ${s.style}`, weight: 2 };
  const [east, north] = s.coordinates;
  if (s.type === "LineString") L.polyline(s.coordinates.map(([e, n]) => at(e, n)), style).addTo(group).bindTooltip(s.text);
  else if (s.type === "Polygon") {
    const area = L.polygon(s.coordinates.map((ring) => ring.map(([e, n]) => at(e, n))), { ...style, interactive: !!s.text }).addTo(group);
    if (s.text) area.bindTooltip(s.text, { sticky: true });
  }
  else if (!s.rank) L.circleMarker(at(east, north), { ...style, radius: 5 }).addTo(group).bindTooltip(s.text);
  else {
    const parts = [[s.radius, `under`], [s.radius, s.style + (s.rank === 1 ? " best" : "")]];
    if (s.style === "site" && s.room > s.radius) parts.push([s.room, "room"]);
    for (const [radius, className] of parts) {
      L.circle(at(east, north), { radius, className: `shape disc ${className}`, interactive: false }).addTo(group);
    }
    const icon = L.divIcon({ className: `number ${s.style}${s.rank === 1 ? " best" : ""}`, html: String(s.rank), iconSize: [28, 28] });
    s.marker = L.marker(at(east, north), { icon, title: s.text, riseOnHover: true }).addTo(group).bindTooltip(s.text);
  }
}

function placeNumbers(map, places) { // each number beside its disc where it covers other discs and numbers least
  const perMetre = map.options.crs.scale(map.getZoom()), badge = 15;
  const discs = places.map((s) => ({ ...map.latLngToContainerPoint(s.marker.getLatLng()), r: s.radius * perMetre, s }));
  const numbers = [];
  for (const d of discs) {
    const cost = ({ x, y }) => [...discs.filter((o) => o !== d), ...numbers]
      .reduce((sum, o) => sum + Math.max(o.r + badge - Math.hypot(x - o.x, y - o.y), 0), 0);
    const spots = [0, 45, -45, 90, -90, 135, -135, 180].flatMap((a) => [1, 3].map((far) => {
      const reach = d.r + far * badge, angle = a * Math.PI / 180;
      return { x: d.x + Math.sin(angle) * reach, y: d.y - Math.cos(angle) * reach, far };
    }));
    const spot = spots.reduce((a, b) => cost(b) + b.far < cost(a) + a.far ? b : a);
    numbers.push({ ...spot, r: badge });
    const style = d.s.marker.getElement()?.style;
    if (style) [style.marginLeft, style.marginTop] = [`${spot.x - d.x - 14}px`, `${spot.y - d.y - 14}px`];
  }
}

function shapes(map) {
  const groups = new Map();
  for (const s of data.shapes) {
    if (!groups.has(s.layer)) groups.set(s.layer, [L.layerGroup(), !s.hidden]);
    shape(s, map, groups.get(s.layer)[0]);
  }
  for (const [title, [group, checked]] of groups) overlay(title, group, map, checked);
  const places = data.shapes.filter((s) => s.marker).sort((a, b) => a.rank - b.rank);
  map.on("zoomend layeradd", () => placeNumbers(map, places));
  placeNumbers(map, places);
  return places;
}

// ---- sites and candidates linked with their rows and photos

function link(map, places, probe) {
  for (const s of places) {
    const rows = document.querySelectorAll(`[data-place="${s.rank}"]`), badge = () => s.marker.getElement();
    const light = (on) => [...rows, badge()].forEach((e) => e && e.classList.toggle("lit", on));
    const go = (event) => {
      event.preventDefault();
      map.setView(s.marker.getLatLng(), Math.max(map.getZoom(), Math.log2(60 / s.radius)));
      probe.pin(s.marker.getLatLng());
    };
    for (const row of rows) {
      for (const name of ["mouseenter", "focusin"]) row.addEventListener(name, () => light(true));
      for (const name of ["mouseleave", "focusout"]) row.addEventListener(name, () => light(false));
      row.querySelectorAll("a[href='#explore']").forEach((a) => a.addEventListener("click", (e) => {
        go(e);
        $("map").focus();
      }));
    }
    s.marker.on("mouseover", () => light(true)).on("mouseout", () => light(false)).on("click", (e) => go(e.originalEvent));
    s.marker.on("keypress", (e) => e.originalEvent.key === "Enter" && go(e.originalEvent));
    const icon = badge();
    if (icon) for (const [name, on] of [["focus", true], ["blur", false]]) icon.addEventListener(name, () => light(on));
  }
}

// ---- the probe

function coordinates(place) {
  if (!data.geodetic) return `${place.lng.toFixed(2)} m east, ${place.lat.toFixed(2)} m north of the origin`;
  const [e, n] = [place.lng / 1000, place.lat / 1000], terms = [1, e, n, e * e, e * n, n * n];
  const sum = (name) => data.geodetic[name].reduce((s, c, i) => s + c * terms[i], 0).toFixed(7);
  return `${sum("latitude")}, ${sum("longitude")}`;
}

function facts(place) {
  const text = (name) => textAt(name, place), chance = text("p_safe"), out = [];
  const sigma = text("sigma"), sure = text("confidence"), height = text("height");
  const factors = ["p_relief", "p_obstacle", "p_ground", "p_wires"].filter((name) => text(name))
    .map((name) => `${data.fields[name].title} ${text(name)}`);
  out.push(["Height", height ? height + (sigma ? ` ± ${sigma}` : "") : text("flags")]);
  out.push(["Slope", text("slope")], ["Largest bump", text("roughness")]);
  const refused = chance === "0 %"; // its factors are those of the limits that it keeps
  out.push(["P(safe)", data.fields.p_safe ? (refused ? "0 %, refused" : chance || "cannot be judged") : null]);
  out.push(["made of", chance && !refused && factors.length ? factors.join(", ") : null]);
  out.push(["Verdict", text("reasons")], ["Smallest obstacle found", text("resolved")]);
  out.push(["Land cover", text("cover") && text("cover") + (sure ? ` (${sure} sure)` : "")]);
  out.push(["Height flags", height ? text("flags") : null], ["Pictures", text("views")]);
  return out.filter(([, value]) => value);
}

function probing(map) {
  const cross = L.marker(map.getCenter(), { interactive: false, keyboard: false, icon: L.divIcon({ className: "cross", iconSize: [24, 24] }) });
  const probe = { pinned: null };
  const show = (place) => {
    const where = coordinates(place), rows = facts(place);
    $("where").value = where;
    $("facts").replaceChildren(...(rows.length ? rows : [["", "nothing was mapped here"]])
      .map(([name, value]) => element("div", {}, element("dt", {}, name), element("dd", {}, value))));
  };
  probe.pin = (place) => {
    probe.pinned = place;
    cross.setLatLng(place).addTo(map);
    show(place);
    $("spoken").textContent = facts(place).map((row) => row.join(" ")).join(", ");
  };
  probe.release = () => {
    probe.pinned = null;
    cross.remove();
  };
  let next = null;
  map.on("mousemove", (e) => {
    if (!next && !probe.pinned) requestAnimationFrame(() => { show(next); next = null; });
    if (!probe.pinned) next = e.latlng;
  });
  $("map").addEventListener("keydown", (e) => {
    if (e.key === "Enter" && e.target === $("map")) probe.pin(map.getCenter());
    if (e.key === "Escape") probe.release();
  });
  map.on("moveend", () => { if ($("map").matches(":focus-visible") && !probe.pinned) show(map.getCenter()); });
  $("copy").addEventListener("click", async () => {
    $("where").select();
    try { await navigator.clipboard.writeText($("where").value); } catch { document.execCommand("copy"); }
    $("spoken").textContent = $("copy").textContent = "Copied";
    setTimeout(() => { $("copy").textContent = "Copy"; }, 1500);
  });
  return probe;
}

// ---- the ruler

function ruler(map, probe) {
  const line = L.polyline([], { className: "shape rule", weight: 3, interactive: false });
  const button = $("ruler"), length = () => line.getLatLngs().reduce((sum, p, i, all) => i ? sum + map.distance(p, all[i - 1]) : 0, 0);
  const measure = () => {
    const points = line.getLatLngs(), ends = [points[0], points.at(-1)].map((p) => p && valueAt("height", p));
    const rise = ends.every((h) => typeof h === "number") ? `, ${ends[1] < ends[0] ? "down" : "up"} ${metres(Math.abs(ends[1] - ends[0]))}` : "";
    $("measured").textContent = points.length < 2 ? "Click two points or more." : metres(length()) + rise;
  };
  const use = (on) => {
    button.setAttribute("aria-pressed", on);
    line.setLatLngs([]);
    on ? line.addTo(map) : line.remove();
    on ? measure() : $("measured").textContent = "";
  };
  const isOn = () => button.getAttribute("aria-pressed") === "true";
  const add = (place) => { line.addLatLng(place); measure(); };
  button.addEventListener("click", () => use(!isOn()));
  map.on("click", (e) => isOn() ? add(e.latlng) : probe.pin(e.latlng));
  $("map").addEventListener("keydown", (e) => {
    if (e.key === "Escape") use(false);
    if (e.key === "Enter" && isOn() && e.target === $("map")) add(map.getCenter());
  });
}

// ---- the profile of the route, or of the flight

function profile(map) {
  const way = data.shapes.find((s) => s.style === "route") || data.shapes.find((s) => s.style === "flown");
  if (!way || way.coordinates.length < 2) return;
  const points = [];
  way.coordinates.forEach(([e, n, u], i) => { // steps of a metre or so between the vertices, for the ground below
    const [a, b, c] = way.coordinates[i - 1] ?? [e, n, u], steps = Math.max(1, Math.ceil(Math.hypot(e - a, n - b)));
    for (let k = i ? 1 : steps; k <= steps; k++) {
      const t = k / steps, place = at(a + t * (e - a), b + t * (n - b)), last = points.at(-1);
      points.push({ place, up: c + t * (u - c) + data.origin, ground: valueAt("height", place), far: last ? last.far + map.distance(place, last.place) : 0 });
    }
  });
  const known = points.flatMap((p) => p.ground === null ? [p.up] : [p.up, p.ground]);
  const [low, high, far] = [Math.min(...known), Math.max(...known), points.at(-1).far || 1];
  $("profile").hidden = false;
  const ground = points.filter((p) => p.ground !== null), svg = $("profile").querySelector("svg"), wide = svg.clientWidth - 90;
  svg.setAttribute("viewBox", `0 0 ${wide + 90} 240`);
  const x = (p) => 60 + wide * p.far / far, y = (h) => 200 - 170 * (h - low) / (high - low || 1);
  const line = (list, of) => list.map((p) => `${x(p).toFixed(1)},${y(of(p)).toFixed(1)}`).join(" ");
  const name = way.style === "route" ? "The route to site 1" : "The flight";
  svg.setAttribute("aria-label", `${name}: ${metres(far)} long, heights from ${low.toFixed(1)} to ${high.toFixed(1)} m`);
  svg.append(
    drawn("polyline", { class: "ground", points: line(ground, (p) => p.ground) }),
    drawn("polyline", { class: "way", points: line(points, (p) => p.up) }),
    ...[low, high].map((h) => drawn("text", { x: 52, y: y(h) + 5, "text-anchor": "end" }, `${h.toFixed(0)} m`)),
    ...[0, far].map((d, i) => drawn("text", { x: 60 + wide * i, y: 228, "text-anchor": i ? "end" : "start" }, i ? metres(d) : "0")));
  const ring = L.circleMarker(points[0].place, { className: "shape waypoint", radius: 7, interactive: false });
  svg.addEventListener("pointermove", (e) => {
    const box = svg.getBoundingClientRect(), wanted = far * ((e.clientX - box.left) / box.width * (wide + 90) - 60) / wide;
    const p = points.reduce((a, b) => Math.abs(b.far - wanted) < Math.abs(a.far - wanted) ? b : a);
    ring.setLatLng(p.place).addTo(map);
    $("profile").querySelector("figcaption").textContent = `${metres(p.far)} along: ${p.up.toFixed(1)} m`
      + (p.ground === null ? "" : `, ${metres(p.up - p.ground)} above the ground`);
  });
  svg.addEventListener("pointerleave", () => ring.remove());
  $("profile").querySelector("h3").textContent = name;
}

// ---- all of it

async function explore() {
  for (const field of Object.values(data.fields)) await unpack(field);
  document.documentElement.classList.add("live"); // hides the picture that stands for the map without scripts
  $("explore").hidden = false;
  const whole = bounds(data.picture);
  const map = L.map("map", {
    crs: L.CRS.Simple, attributionControl: false, zoomSnap: 0.25, zoomDelta: 0.5, wheelPxPerZoomLevel: 120, minZoom: -6,
    maxZoom: Math.log2(40 / data.picture.cell), maxBounds: whole.pad(0.5),
  });
  for (const [name, level] of [["picture", 200], ["layer", 250], ["shade", 300]]) map.createPane(name).style.zIndex = level;
  map.fitBounds(whole);
  L.imageOverlay(document.querySelector(".big image").getAttribute("href"), whole, { pane: "picture" }).addTo(map);
  L.control.scale({ imperial: false, maxWidth: 160 }).addTo(map);
  layers(map);
  overlay("Hill shading", L.imageOverlay(data.shade, whole, { pane: "shade" }), map, false);
  const probe = probing(map), places = shapes(map);
  link(map, places, probe);
  ruler(map, probe);
  profile(map);
  $("whole").addEventListener("click", () => map.fitBounds(whole));
  document.documentElement.dataset.map = "ready";
}

if (window.DecompressionStream) {
  explore().catch((error) => {
    document.documentElement.classList.remove("live");
    $("explore").hidden = true;
    throw error;
  });
}
