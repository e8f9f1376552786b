"use strict";
// Drawn by hand on a canvas: what the server has binned, so a frame costs the same however long the run is.
const CHANNELS = { pressure: { colour: "#0072B2", dash: [] }, flow: { colour: "#009E73", dash: [7, 3] }, speed: { colour: "#D55E00", dash: [2, 2] }, temperature: { colour: "#8a5a83", dash: [] } };
const INK = "#1a1a1a", GREY = "#6a6a6a", GRID = "#e0e0e0", LIMIT = "#b00020";

function ticks(low, high, most) {
  const raw = (high - low) / Math.max(most, 1) || 1, power = 10 ** Math.floor(Math.log10(raw));
  const step = [1, 2, 5, 10].map(k => k * power).find(s => s >= raw) || raw, found = [];
  for (let t = Math.ceil(low / step) * step; t <= high + step * 1e-6; t += step) found.push(t);
  return { found, digits: Math.max(0, -Math.floor(Math.log10(step))) };
}

function frame(canvas, x, y, xName) {
  const ratio = window.devicePixelRatio || 1, width = canvas.clientWidth, height = canvas.clientHeight;
  if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
    canvas.width = Math.round(width * ratio); canvas.height = Math.round(height * ratio);
  }
  const pen = canvas.getContext("2d");
  pen.setTransform(ratio, 0, 0, ratio, 0, 0);
  pen.clearRect(0, 0, width, height);
  pen.font = "12px 'DejaVu Sans', sans-serif";
  const left = 50, right = width - 10, top = 8, bottom = height - (xName ? 36 : 20);
  const X = v => left + (v - x[0]) / (x[1] - x[0] || 1) * (right - left);
  const Y = v => bottom - (v - y[0]) / (y[1] - y[0] || 1) * (bottom - top);
  pen.lineWidth = 1; pen.fillStyle = INK; pen.strokeStyle = GRID;
  const rows = ticks(y[0], y[1], height > 250 ? 7 : 4), columns = ticks(x[0], x[1], width > 500 ? 8 : 4);
  pen.textAlign = "right"; pen.textBaseline = "middle";
  for (const v of rows.found) { line(pen, [[left, Y(v)], [right, Y(v)]]); pen.fillText(v.toFixed(rows.digits), left - 5, Y(v)); }
  pen.textAlign = "center"; pen.textBaseline = "top";
  for (const v of columns.found) {
    const text = v.toFixed(columns.digits), most = width - pen.measureText(text).width / 2 - 1; // not cut at the edge
    line(pen, [[X(v), top], [X(v), bottom]]); pen.fillText(text, Math.min(X(v), most), bottom + 4);
  }
  if (xName) pen.fillText(xName, (left + right) / 2, bottom + 20);
  pen.strokeStyle = GREY; pen.strokeRect(left, top, right - left, bottom - top);
  pen.save(); pen.beginPath(); pen.rect(left, top, right - left, bottom - top); pen.clip();
  return { pen, X, Y, left, right, top, bottom };
}

function line(pen, points, dash = []) {
  pen.setLineDash(dash); pen.beginPath();
  points.forEach(([a, b], i) => i ? pen.lineTo(a, b) : pen.moveTo(a, b));
  pen.stroke(); pen.setLineDash([]);
}

function limitLine(at, limit, words) {
  if (limit === null || limit === undefined) return;
  const { pen, Y, left, right } = at;
  pen.strokeStyle = LIMIT; pen.lineWidth = 2; line(pen, [[left, Y(limit)], [right, Y(limit)]], [10, 5]);
  pen.fillStyle = LIMIT; pen.textAlign = "left"; pen.textBaseline = "top"; pen.fillText(words, left + 6, Y(limit) + 3);
}

function reach(values, limit) {
  let low = Infinity, high = -Infinity;
  for (const v of values) { if (v < low) low = v; if (v > high) high = v; }
  if (low > high) { low = 0; high = 1; }
  if (limit !== null && limit !== undefined) high = Math.max(high, limit);
  const air = 0.06 * (high - low || Math.abs(high) || 1);
  return [low - air, high + air];
}

// `bins`: [when, lowest, highest]. `other`: those of a run laid beside, from its own start.
function drawStrip(canvas, role, series, other, x) {
  const bins = series ? series.bins : [], limit = series ? series.limit : null;
  const band = series && series.band || []; // what the guard holds for possible at the pressure of the moment
  const beside = (other ? other.bins : []).filter(b => b[0] >= x[0] && b[0] <= x[1]);
  const y = reach([...bins, ...beside, ...band].flatMap(b => [b[1], b[2]]), limit);
  const at = frame(canvas, x, y, ""), { pen, X, Y } = at;
  pen.strokeStyle = "#0072B2"; pen.globalAlpha = 0.18; pen.lineWidth = (at.right - at.left) / Math.max(bins.length, 1) + 0.5;
  for (const [when, low, high] of band) line(pen, [[X(when), Y(low)], [X(when), Y(high)]]);
  pen.globalAlpha = 1;
  if (beside.length) { pen.strokeStyle = GREY; pen.lineWidth = 1.5; line(pen, beside.map(b => [X(b[0]), Y((b[1] + b[2]) / 2)]), [3, 4]); }
  const { colour } = CHANNELS[role];
  pen.fillStyle = colour; pen.strokeStyle = colour; pen.lineWidth = 1.6; pen.globalAlpha = 0.35;
  if (bins.length) {
    pen.beginPath();
    bins.forEach((b, i) => i ? pen.lineTo(X(b[0]), Y(b[2])) : pen.moveTo(X(b[0]), Y(b[2])));
    [...bins].reverse().forEach(b => pen.lineTo(X(b[0]), Y(b[1])));
    pen.fill();
  }
  pen.globalAlpha = 1;
  line(pen, bins.map(b => [X(b[0]), Y((b[1] + b[2]) / 2)]));
  limitLine(at, limit, `limit ${limit} ${series ? series.unit : ""}`);
  if (!bins.length) { pen.fillStyle = GREY; pen.textAlign = "center"; pen.fillText("waits for its first reading", (at.left + at.right) / 2, (at.top + at.bottom) / 2); }
  pen.restore();
}

function mark(pen, x, y, direction, settled) {
  pen.beginPath();
  if (direction === "down") pen.rect(x - 5, y - 5, 10, 10); else pen.arc(x, y, 5.5, 0, 7);
  pen.fillStyle = "#fff"; pen.fill(); pen.stroke();
  if (!settled) line(pen, [[x - 4, y - 4], [x + 4, y + 4]]);
}

function drawPicture(canvas, picture, other) {
  const points = picture.points || [], band = picture.band || [], beside = other ? other.points : [];
  const xs = [...points.map(p => p[0]), ...beside.map(p => p[0]), ...band.map(b => b[0])];
  const top = Math.max(0, ...points.map(p => p[1]), ...beside.map(p => p[1]), picture.limit_rpm || 0);
  const x = xs.length ? [Math.min(...xs) - 0.03, Math.max(...xs) + 0.03] : [1, 2.5];
  const at = frame(canvas, x, [-0.02 * top - 1, 1.08 * top + 1], "pressure, bar abs"), { pen, X, Y } = at;
  if (band.length) {
    pen.fillStyle = "#0072B2"; pen.globalAlpha = 0.18; pen.beginPath();
    band.forEach((b, i) => i ? pen.lineTo(X(b[0]), Y(b[3])) : pen.moveTo(X(b[0]), Y(b[3])));
    [...band].reverse().forEach(b => pen.lineTo(X(b[0]), Y(b[1])));
    pen.fill(); pen.globalAlpha = 1; pen.strokeStyle = "#0072B2"; pen.lineWidth = 1.5;
    line(pen, band.map(b => [X(b[0]), Y(b[2])]), [8, 3]);
  }
  limitLine(at, picture.limit_rpm, `limit ${picture.limit_rpm} rpm`);
  pen.lineWidth = 1.5; pen.strokeStyle = GREY;
  for (const p of beside) { pen.beginPath(); pen.moveTo(X(p[0]), Y(p[1]) - 6); for (const [dx, dy] of [[6, 0], [0, 6], [-6, 0]]) pen.lineTo(X(p[0]) + dx, Y(p[1]) + dy); pen.closePath(); pen.stroke(); }
  pen.strokeStyle = INK; pen.lineWidth = 1.8;
  for (const p of points) mark(pen, X(p[0]), Y(p[1]), p[4], p[3]);
  pen.fillStyle = GREY; pen.textAlign = "left"; pen.textBaseline = "top"; pen.fillText("speed, rpm", at.left + 6, at.top + 4);
  if (!points.length) { pen.textAlign = "center"; pen.fillText("waits for the first plateau", (at.left + at.right) / 2, (at.top + at.bottom) / 2); }
  pen.restore();
}
