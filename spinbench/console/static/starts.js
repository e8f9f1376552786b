"use strict";
// What is started from here: a run, the test that a diagnosis recommends, and the queue. Each with a confirmation.
const ENTRIES = { operator: "operator", motor_serial: "motor's number", lubrication: "lubrication", minutes_running: "running today, min", ambient_pressure_bar_abs: "room's pressure, bar abs", ambient_temperature_c: "room's temperature, °C", relative_humidity: "relative humidity, 0 to 1" };
const WHAT = { level_bar_abs: "level, bar abs", plateaus: "plateaus", added_inertia_kg_m2: "flywheel added, kg m²", after: "belongs to the run", note: "note" };
const TAKES = { sweep: ["note"], zero: ["added_inertia_kg_m2", "after", "note"], plateaus: Object.keys(WHAT) }; // others take all but plateaus
let startsQueue = false, expected = [], recommendedTest = null;

function labelled(name, words, control) {
  const label = make("label");
  control.name = name; label.append(make("span", words), control);
  return label;
}
function entry(name, words) { const input = document.createElement("input"); input.maxLength = 500; return labelled(name, words, input); }
function field(box, name) { return $(box).querySelector(`[name=${name}]`); }

$("what").append(labelled("kind", "what", document.createElement("select")), ...Object.entries(WHAT).map(([name, words]) => entry(name, words)));
$("entries").append(...Object.entries(ENTRIES).map(([name, words]) => entry(name, words)));
field("entries", "operator").value = recalled("operator", "");
for (const [name, low, high, step] of [["level_bar_abs", 0, 100, "any"], ["plateaus", 1, 1000, 1], ["added_inertia_kg_m2", 0, 100, "any"]]) Object.assign(field("what", name), { type: "number", min: low, max: high, step });

function taken() { const kind = field("what", "kind").value; return TAKES[kind] || Object.keys(WHAT).filter(name => name !== "plateaus"); }
function planned() {
  const found = { kind: field("what", "kind").value };
  for (const name of taken()) if (field("what", name).value.trim()) found[name] = field("what", name).value.trim();
  return found;
}

// The table of what is to be taken, as it will be: every entry that is left out stands with what the bench file says.
function drawPlanned() {
  const b = held.console.bench, of = planned(), kept = { "kept in": held.console.logs };
  for (const name of Object.keys(WHAT)) { const is = taken().includes(name); field("what", name).closest("label").hidden = !is; field("what", name).disabled = !is; }
  const limits = `${b.highest_speed_rpm} rpm, ${b.highest_pressure_bar_abs} bar abs`, about = { bench: `${b.name}: ${b.title}` };
  if (recommendedTest) Object.assign(about, { "recommended test": recommendedTest.test, "tells apart": recommendedTest.separates.join(", ") });
  if (of.kind === "sweep") Object.assign(about, { levels: `${b.levels.join(", ")} bar abs, ${b.order}${b.repeats > 1 ? `, ${b.repeats} times` : ""}`, captures: b.captures.join(", ") || "none" });
  else if (of.kind !== "zero") about.level = `${of.level_bar_abs || `${b.capture_level} (of the bench file)`} bar abs${of.kind === "plateaus" ? `, ${of.plateaus || 10} plateaus` : ""}`;
  pairs($("planned"), { ...about, limits, ...kept });
  const added = of.added_inertia_kg_m2;
  put($("flywheel"), added !== undefined && Number(added) !== b.added_inertia ? `Before you start: ${Number(added) ? `mount a flywheel of ${added} kg m²` : "take the flywheel off"}.` : "");
}

function openDialog(title, queue) {
  const b = held.console.bench;
  if (!held.console.controls) { refuse("This window only watches: take control first."); return; }
  startsQueue = queue;
  put($("start-title"), title);
  $("what").hidden = queue; $("start-add").hidden = queue;
  for (const control of $("what").querySelectorAll("input, select")) control.disabled = queue;
  for (const [name, [low, high]] of Object.entries(b.ranges)) Object.assign(field("entries", name), { type: "number", step: "any", min: low, max: high, placeholder: `${low} to ${high}` });
  put($("start-warning"), `An empty entry is left to the bench file${b.by_hand ? ", or asked for. You set the valve, and enter what the dials show:" : ". The regulator will be raised:"} is the guard in place, and the relief valve set?`);
  put($("start-now"), b.by_hand ? "Start: each reading will be asked for" : "Start: the line will be under pressure");
  $("report-dialog").close();
  $("start-dialog").show();
  field("entries", "operator").focus();
}

function openStart(of, test = null) {
  recommendedTest = test;
  fill(field("what", "kind"), held.console.bench.kinds.map(kind => new Option(kind)));
  field("what", "kind").value = of.kind;
  for (const name of Object.keys(WHAT)) field("what", name).value = of[name] ?? "";
  openDialog(test ? "Start the recommended test" : "Start a run", false);
  if ($("start-dialog").open) { field("what", "kind").disabled = false; drawPlanned(); }
}

function testButton(test) {
  const button = make("button", `Next test: ${test.test}…`);
  button.title = `tells apart ${test.separates.join(", ")}${test.nats === null ? "" : `; ${test.nats} nats`}`;
  button.onclick = () => openStart(test.planned, test);
  return button;
}

$("what").addEventListener("input", drawPlanned);
$("start").onclick = () => openStart({ kind: "sweep" });
$("start-dialog").addEventListener("close", () => {
  const pressed = $("start-dialog").returnValue;
  $("start-dialog").returnValue = "";
  if (pressed === "add") { change("queue", { do: "add", planned: planned() }, "Added to the queue."); return; }
  if (pressed !== "start") return;
  const answers = Object.fromEntries(Object.keys(ENTRIES).map(name => [name, field("entries", name).value.trim()]));
  keep("operator", answers.operator);
  shown = { run: "", replay: 0 }; connect();
  $("refused").hidden = true;
  if (startsQueue) change("queue", { do: "start", answers, expected }, "The queue is being started.");
  else change("start", { answers, planned: planned() }, "The run is being started.");
});

// ---- the queue

function said(one) { return `${one.words}${one.flywheel ? `, with ${one.flywheel}` : ""}${one.note ? ` (${one.note})` : ""}`; }

let queueShown = "";
function drawQueue() {
  const { queue, controls, running } = held.console, key = JSON.stringify([queue, controls, running]);
  if (key === queueShown) return;
  queueShown = key;
  const focused = document.activeElement.dataset?.act;
  put($("queue-said"), queue.going ? `▶ goes on by itself, ${queue.waiting.length} to come` : `${queue.waiting.length ? `${queue.waiting.length} to come` : "is empty"}. ${queue.said}`);
  $("queue-start").disabled = !controls || queue.going || running || !queue.waiting.length;
  $("queue-hold").disabled = !controls || !queue.going;
  $("queue-file").disabled = !controls;
  fill($("queue"), queue.waiting.map((one, i) => {
    const li = make("li");
    li.append(make("span", `${said(one)} `));
    for (const [act, words] of [["up", "↑"], ["down", "↓"], ["clone", "Clone"], ["remove", "Remove"]]) {
      const button = make("button", words);
      button.dataset.act = `${act} ${one.n}`;
      button.setAttribute("aria-label", `${act} ${i + 1}: ${one.words}`);
      button.disabled = !controls;
      button.onclick = () => change("queue", { do: act, n: one.n }, "The queue is changed.");
      li.append(button);
    }
    return li;
  }));
  if (focused) $("queue").querySelector(`[data-act="${focused}"]`)?.focus();
}

$("queue-hold").onclick = () => change("queue", { do: "hold" }, "The queue is held; the run goes on.");
$("queue-start").onclick = () => {
  const { waiting } = held.console.queue;
  recommendedTest = null; expected = waiting.map(one => one.n);
  openDialog("Start the queue", true);
  pairs($("planned"), { bench: `${held.console.bench.name}: ${held.console.bench.title}`, ...Object.fromEntries(waiting.map((one, i) => [`${i + 1}.`, said(one)])) });
  put($("flywheel"), waiting[0].flywheel ? `Before you start: ${waiting[0].flywheel}.` : "");
};
$("queue-file").onchange = async () => {
  const [file] = $("queue-file").files;
  if (file) change("queue", { do: "load", text: await file.text() }, "The table is in the queue.");
  $("queue-file").value = "";
};
