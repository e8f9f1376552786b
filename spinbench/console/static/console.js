"use strict";
// The page draws what the server says and keeps nothing of a run: each connection begins with everything.
const LOST_MS = 1500, RETRY_MS = 700, STOP_MS = 2000, TOLD_MS = 6000;
const SPANS = [[60, "1 min"], [600, "10 min"], [0, "whole run"]];
const MARKS = { good: "✓", unsure: "?", bad: "✕", old: "⚠", none: "–", past: "–" };
const CLOSE = "Close the supply by hand now, and use the bench's own shut-off.";
const $ = id => document.getElementById(id);
const held = {};          // the parts as the server said them last
let heard = 0, source = null, shown = { run: "", replay: 0 }, beside = null, besideName = "", listed = "";
let span = Number(recalled("span", "60")), lost = true, dirty = true, localStop = null;
const windowId = session("window", () => Math.random().toString(36).slice(2, 10));
const windowName = `window ${windowId.slice(0, 4)}`;

// What a browser will not keep (a private window) is not kept.
function recalled(key, other) { try { return localStorage.getItem(`spinbench ${key}`) ?? other; } catch { return other; } }
function keep(key, value) { try { localStorage.setItem(`spinbench ${key}`, value); } catch { /* not kept */ } }
function session(key, make) { try { return sessionStorage.getItem(key) ?? (sessionStorage.setItem(key, make()), sessionStorage.getItem(key)); } catch { return make(); } }

const given = new URLSearchParams(location.hash.slice(1)).get("token");
if (given) { keep("token", given); history.replaceState(null, "", "/"); }
let token = given || recalled("token", "");

function make(tag, text = "", kind = "") { const made = document.createElement(tag); made.textContent = text; if (kind) made.className = kind; return made; }
function put(node, text) { if (node.textContent !== text) node.textContent = text; }
function fill(node, children) { node.replaceChildren(...children); }

// ---- the link

function connect() {
  if (source) source.close();
  const asked = new URLSearchParams({ span, window: windowId });
  if (shown.run) { asked.set("run", shown.run); asked.set("replay", shown.replay); }
  const mine = source = new EventSource(`/events?${asked}`);
  let first = true;
  mine.onmessage = event => {
    if (mine !== source) return;
    if (first) { for (const key of Object.keys(held)) delete held[key]; first = false; }
    Object.assign(held, JSON.parse(event.data));
    heard = performance.now(); dirty = true;
    if (lost) setLost(false);
  };
  mine.onerror = () => {
    if (mine === source && mine.readyState === EventSource.CLOSED && !heard) whyNothing();
    if (mine !== source || mine.readyState !== EventSource.CLOSED || lost || !shown.run) return;
    refuse(`${shown.run} cannot be shown: spinbench runs show says why.`);
    show("", 0);
  };
}

// A console that serves other machines shows nothing to a browser that never had its token.
async function admitted() { if (token) await post("watch", {}, token).catch(() => {}); }
async function whyNothing() {
  const answer = await fetch("/api/runs").catch(() => null);
  if (answer && answer.status === 403) put($("lost-for"), (await answer.json()).error);
}

function setLost(is) {
  lost = is;
  $("lost").hidden = !is;
  $("main").inert = is;
  document.body.classList.toggle("is-lost", is);
  if (is) { put($("word"), "link lost"); put($("still"), ""); put($("explanation"), ""); put($("waits"), ""); $("badge").className = "badge alert"; }
  else { listed = ""; dirty = true; if (localStop && localStop.link) localStop = null; }
}

let tried = 0;
setInterval(() => {
  const silent = performance.now() - heard;
  if (silent > LOST_MS) {
    if (!lost) setLost(true);
    if (heard) put($("lost-for"), `No word from the console for ${Math.round(silent / 1000)} s. It is being tried again.`);
    if (performance.now() - tried > RETRY_MS) { tried = performance.now(); connect(); }
  }
}, 200);

async function post(what, body, key, within = 5000) {
  const answer = await fetch(`/api/${what}`, {
    method: "POST", headers: { "content-type": "application/json", "x-spinbench-token": key },
    body: JSON.stringify({ window: windowId, name: windowName, ...body }), signal: AbortSignal.timeout(within),
  });
  const said = await answer.json();
  if (!answer.ok) throw new Error(said.error || `status ${answer.status}`);
  return said;
}

async function change(what, body, done) {
  try { await post(what, body, token); tell(done); } catch (error) { refuse(error.message); }
}

// A refusal stays until it is closed; what went well fades.
function refuse(why) { $("refused").hidden = false; put($("refused").querySelector("span"), why); }
let fading = 0;
function tell(text) { $("told").hidden = false; put($("told"), text); clearTimeout(fading); fading = setTimeout(() => { $("told").hidden = true; }, TOLD_MS); }

// ---- STOP

async function stop() {
  dismissed = "";
  localStop = { word: "asked", text: "The order is on its way.", link: false };
  showStop();
  try {
    const said = await post("stop", {}, (held.console && held.console.stop_token) || stopToken || token, STOP_MS);
    localStop = null;
    if (held.console) held.console.stop = said;
  } catch (error) {
    localStop = { word: "NOT DELIVERED", text: `${error instanceof TypeError || error.name === "TimeoutError" ? "The console cannot be reached" : error.message}. ${CLOSE}`, link: true };
  }
  showStop();
}
let stopToken = "";

function showStop() {
  const told = localStop || (held.console && held.console.stop), box = $("stop-told");
  box.hidden = !told || `${told.word} ${told.text}` === dismissed;
  if (box.hidden) return;
  box.className = told.word === "NOT DELIVERED" ? "bad" : "";
  put(box.querySelector("b"), told.word === "asked" ? "STOP asked" : `STOP ${told.word}`);
  put(box.querySelector("span"), `${told.text}${told.by ? ` (pressed in ${told.by})` : ""}`);
}
let dismissed = "";

// ---- drawing

function draw() {
  requestAnimationFrame(draw);
  if (!dirty || !held.console || lost) return;
  dirty = false;
  stopToken = held.console.stop_token;
  const run = held.run;
  document.body.classList.toggle("no-run", !run);
  drawHead(run); drawBar(); drawQueue(); drawByHand(run); showStop();
  if (run) { drawFigures(); drawCharts(); drawPictureAndCheck(); drawSteps(); drawEvents(); drawSetting(run); }
  drawAlarms(run);
  const key = `${held.console.latest} ${held.console.latest_state}`;
  if (key !== listed) { listed = key; list(); }
}

function drawHead(run) {
  const state = held.state, name = run ? run.name : "no run yet";
  const live = run && run.live && !run.replay;
  put($("word"), state ? state.word : held.console.starting ? "starting" : "idle");
  $("badge").className = `badge ${["failed", "tripped", "killed"].includes(state && state.word) ? "alert" : live ? "live" : ""}`;
  const about = run && run.replay ? `REPLAY ×${run.replay} of ` : run && !run.live ? "PAST RUN " : "";
  put($("run-name"), `${about}${name}${run && run.simulated ? " (virtual bench)" : ""}`);
  document.title = `${state ? state.word : "idle"} · spinbench`;
  put($("explanation"), held.console.unreadable || (held.console.starting && !live ? "A run is being started." : state ? state.explanation : "Start a run here, or in a terminal: this page follows it."));
  if (!state || state.still_s === null) { put($("still"), ""); put($("waits"), state && state.waits_for ? `Waits for ${state.waits_for}.` : ""); return; }
  put($("still"), `${state.at_most ? "at most " : ""}${state.still_s.toFixed(0)} s left`);
  put($("waits"), `Waits for ${state.waits_for}: ${state.at_most ? "at most " : ""}${state.still_s.toFixed(0)} of ${state.of_s.toFixed(0)} s left.`);
}

function drawBar() {
  const c = held.console, many = `${c.windows} window${c.windows === 1 ? "" : "s"}`;
  const who = c.controls ? "This window controls" : c.controller ? `${c.controller} controls${c.controller_is_there ? "" : " (it is closed)"}; this window watches` : "Nobody controls; this window watches";
  put($("control-told"), `${who} · ${many} · this is ${windowName}`);
  $("take").disabled = c.controls;
  $("start").disabled = !c.controls;
  $("start-now").disabled = c.queue.going || c.running || (held.run && held.run.live && !held.run.replay);
  $("back").hidden = !shown.run;
  put($("back"), c.latest_state === "being written" ? "A RUN GOES ON: back to it" : "Back to the newest run");
  drawStartRefused(c.start_failed);
}

// A refusal belongs to one start: the next start takes it back, and is refused in words of its own.
let failedStart = 0, failedText = "";
function drawStartRefused(failed) {
  if (failed && failed.start === failedStart) return;
  if (failedText && $("refused").querySelector("span").textContent === failedText) $("refused").hidden = true;
  failedStart = failed ? failed.start : 0;
  failedText = failed ? `The run did not begin: ${failed.text}` : "";
  if (failed) refuse(failedText);
}

function drawFigures() {
  const box = $("figures");
  if (box.children.length !== held.figures.length) {
    fill(box, held.figures.map(figure => {
      const one = make("div", "", "figure");
      one.style.setProperty("--colour", CHANNELS[figure.role].colour);
      const value = make("div", "", "value");
      value.append(make("span"), make("small"));
      one.append(make("div", figure.role, "name"), value, make("div", "", "quality"));
      return one;
    }));
  }
  held.figures.forEach((figure, i) => {
    const one = box.children[i], quality = one.children[2];
    put(one.children[1].children[0], figure.text);
    put(one.children[1].children[1], ` ${figure.unit}`);
    put(quality, `${MARKS[figure.mark]} ${figure.quality}`);
    quality.className = `quality ${figure.mark}`;
    one.classList.toggle("past", figure.mark === "past");
  });
}

function drawCharts() {
  const box = $("charts"), { series, from_s, until_s } = held.charts, roles = ["pressure", "flow", "speed"].filter(r => held.figures.some(f => f.role === r));
  if (box.dataset.roles !== roles.join()) {
    box.dataset.roles = roles.join();
    fill(box, roles.flatMap(role => {
      const name = make("div", "", "chart-name"), canvas = document.createElement("canvas");
      name.append(make("span"), make("span"));
      canvas.setAttribute("role", "img"); canvas.dataset.role = role;
      return [name, canvas];
    }));
  }
  const x = [from_s, Math.max(until_s, from_s + 1)];
  roles.forEach((role, i) => {
    const one = series[role], canvas = box.children[2 * i + 1], name = box.children[2 * i];
    const figure = held.figures.find(f => f.role === role);
    put(name.children[0], `${role}, ${one ? one.unit : ""}`);
    put(name.children[1], i === roles.length - 1 ? "seconds of the bench's clock" : "");
    canvas.setAttribute("aria-label", `${role} in time; now ${figure.text} ${figure.unit}`);
    drawStrip(canvas, role, one, beside && beside.charts.series[role], x);
  });
}

function drawPictureAndCheck() {
  const picture = held.picture, check = held.check, lamp = $("lamp");
  const words = { none: "– not checked", waits: "○ too early", fits: "✓ model fits", differs: "▲ MISMATCH" };
  lamp.className = check.lamp; put(lamp, words[check.lamp]); put($("check-text"), check.text);
  drawPicture($("picture"), picture, beside && beside.picture);
  $("picture").setAttribute("aria-label", `speed over pressure: ${picture.points.length} plateaus; ${check.text}`);
  put($("picture-key"), `○ rising leg, □ falling leg, struck through: not settled. Band: what the guard holds for possible, 1 to 99 %.${besideName ? ` ◇ ${besideName}, laid beside.` : ""}`);
  const f = picture.f_overall;
  put($("friction"), f ? `f_overall so far: ${f.mean.toFixed(4)} ± ${f.sd.toFixed(4)} N m s, as the guard has it after ${picture.turning} plateau${picture.turning === 1 ? "" : "s"} with the rotor turning. spinbench fit says it better once the run has ended.` : "");
}

function drawSteps() {
  const { steps, captures, still_s } = held.steps, marks = { done: "✓ ", running: "▶ ", "left out": "✕ ", "to come": "" };
  const arrows = { up: "↑", down: "↓" };
  fill($("steps"), [
    ...steps.map(s => { const li = make("li", `${marks[s.status]}${s.level.toFixed(2)} bar ${arrows[s.direction] || ""}${s.added ? " added" : ""}`, s.status.replace(" ", "-")); if (s.status === "running") li.setAttribute("aria-current", "step"); li.title = s.status; return li; }),
    ...captures.map(c => make("li", `${marks[c.status]}${c.kind} at ${c.level.toFixed(2)} bar`, c.status))]);
  const done = steps.filter(s => s.status === "done").length;
  put($("course-left"), steps.length ? `${done} of ${steps.length} plateaus${still_s === null ? "" : `, about ${still_s < 90 ? `${still_s} s` : `${Math.round(still_s / 60)} min`} left`}` : "");
}

let eventsShown = "";
function drawEvents() {
  const key = held.run.name + (held.events.length ? held.events[held.events.length - 1].n : "");
  if (key === eventsShown) return;
  eventsShown = key;
  fill($("events"), [...held.events].reverse().map(e => { const li = make("li"); li.append(make("span", `${e.at_s.toFixed(1)} s`), make("b", e.kind), make("span", e.text)); return li; }));
}

let alarmsShown = "";
function drawAlarms(run) {
  const alarms = run ? held.alarms : [], key = JSON.stringify([alarms, held.console.controls, run && run.name]);
  if (key === alarmsShown) return;
  alarmsShown = key;
  $("alarms-box").hidden = !alarms.length;
  fill($("alarms"), alarms.map(alarm => {
    const li = make("li", "", alarm.acknowledged ? "seen" : ""), words = make("span");
    words.append(make("b", `${alarm.acknowledged ? "seen" : "▲ NEW"} · ${alarm.at_s.toFixed(0)} s · ${alarm.text}`), document.createElement("br"), make("span", `What to do: ${alarm.guidance}`));
    li.append(words);
    if (!alarm.acknowledged) {
      const button = make("button", "Acknowledge");
      button.disabled = !held.console.controls;
      button.onclick = () => change("acknowledge", { run: run.name, n: alarm.n }, "Acknowledged.");
      li.append(button);
    }
    return li;
  }));
}

function pairs(node, of) { fill(node, Object.entries(of).flatMap(([key, value]) => [make("dt", key.replaceAll("_", " ")), make("dd", value)])); }
let settingShown = "";
function drawSetting(run) { const key = JSON.stringify(run.setting); if (key !== settingShown) { settingShown = key; pairs($("setting"), run.setting); } }

// ---- runs

async function list() {
  let rows;
  try { rows = await (await fetch("/api/runs")).json(); } catch { listed = ""; return; }
  fill($("runs"), rows.map(row => {
    const tr = document.createElement("tr"), reports = make("td"), shows = make("td");
    const add = (to, text, label, act) => { const b = make("button", text); b.setAttribute("aria-label", label); b.onclick = act; to.append(b); };
    for (const path of row.reports) add(reports, path.split("/").slice(2).join("/"), `report ${path}`, () => openReport(path, row.tests));
    reports.append(...row.tests.filter(test => test.planned).slice(0, 3).map(testButton));
    add(shows, "Show", `show ${row.name}`, () => show(row.name, 0));
    if (!row.imported) add(shows, "Replay ×10", `replay ${row.name}`, () => show(row.name, 10));
    add(shows, besideName === row.name ? "Take away" : "Lay beside", `lay ${row.name} beside`, () => layBeside(row.name));
    tr.append(make("td", row.name), make("td", row.kind), make("td", row.outcome), make("td", String(row.plateaus)), reports, shows);
    return tr;
  }));
}

function show(run, replay) { shown = { run, replay }; eventsShown = ""; connect(); window.scrollTo(0, 0); }
async function layBeside(name) {
  if (besideName === name) { beside = null; besideName = ""; }
  else {
    try { const answer = await fetch(`/api/runs/${encodeURIComponent(name)}`); if (!answer.ok) throw new Error((await answer.json()).error); beside = await answer.json(); besideName = name; }
    catch (error) { refuse(error.message); return; }
  }
  dirty = true; list();
}
function openReport(path, tests) {
  fill($("report-tests"), tests.filter(test => path.startsWith(`${test.report}/`)).map(test => test.planned ? testButton(test) : make("span", `${test.test}: ${test.why_not}. `)));
  $("report").src = `/files/${path.split("/").map(encodeURIComponent).join("/")}`; $("report-dialog").show();
}

// ---- controls

$("stop").onclick = stop;
$("stop-seen").onclick = () => { const told = localStop || held.console.stop; dismissed = told ? `${told.word} ${told.text}` : ""; showStop(); };
$("refused-seen").onclick = () => { $("refused").hidden = true; };
$("take").onclick = () => change("control", {}, "This window controls.");
$("back").onclick = () => show("", 0);
$("look").onclick = list;
function setBig(is) { document.body.classList.toggle("big", is); $("big").setAttribute("aria-pressed", is); keep("big", is); dirty = true; }
$("big").onclick = () => setBig(!document.body.classList.contains("big"));
setBig(recalled("big", "false") === "true");
for (const [seconds, words] of SPANS) {
  const button = make("button", words);
  button.onclick = () => { span = seconds; keep("span", span); press(); connect(); };
  button.dataset.span = seconds;
  $("spans").append(button);
}
function press() { for (const b of $("spans").children) b.setAttribute("aria-pressed", Number(b.dataset.span) === span); }
press();

function pressed(event) {
  if (event.key === "F8") { event.preventDefault(); stop(); return; }
  if (event.ctrlKey || event.altKey || event.metaKey || event.target.matches("input:not([type=file]), textarea, select")) return;
  const key = event.key.toLowerCase();
  if (key === "s") stop();
  else if (lost) return;
  else if (key === "b") $("big").click();
  else if (key === "t") $("take").click();
}
document.addEventListener("keydown", pressed, true);
$("report").addEventListener("load", () => $("report").contentDocument?.addEventListener("keydown", pressed, true));
window.addEventListener("resize", () => { dirty = true; });

document.addEventListener("DOMContentLoaded", () => { admitted().then(connect); draw(); }); // once every script is there
