"use strict";
// A run by hand: what it asks is answered here. It checks each answer as it checks what is typed in a terminal.
const ENTER = { readings: "It is set: count down", pressure: "It was not read", vented: "The valve is closed and the line is vented", line: "Leave it empty (Enter)" };
let handFields = "", handAsks = null;

function drawByHand(run) {
  const e = held.console.entries, box = $("by-hand"), elsewhere = !e && run && run.live && !run.replay && held.console.bench.by_hand;
  box.hidden = !e && !elsewhere;
  $("hand-form").hidden = !e;
  if (!e) { put($("hand-question"), "This run was not started from a console: type its readings in the terminal where it was started."); fill($("hand-said"), []); handFields = ""; return; }
  put($("hand-said"), e.said.join("\n"));
  put($("hand-question"), e.question);
  const key = JSON.stringify([e.kind, e.fields]);
  if (key !== handFields) {
    handFields = key;
    fill($("hand-fields"), e.fields.map(one => {
      const input = document.createElement("input"), label = make("label"), ends = [one.low === null ? "" : `<${one.low}`, one.high === null ? "" : `>${one.high}`].filter(Boolean);
      input.name = one.name; input.inputMode = "decimal"; input.autocomplete = "off"; input.maxLength = 20;
      input.placeholder = [...ends, "- not read"].join(", ");
      label.append(make("span", `${one.label}, ${one.unit}`), input);
      return label;
    }));
    put($("hand-enter"), ENTER[e.kind]);
    $("hand-send").hidden = !e.fields.length;
  }
  if (handAsks !== null && handAsks !== e.asks) { // answered: what was entered is not entered again by mistake
    for (const input of $("hand-form").querySelectorAll("input")) input.value = "";
    handAsks = null;
  }
  const may = held.console.controls && !e.answered;
  for (const button of $("hand-form").querySelectorAll("button")) button.disabled = !may;
  put($("hand-commands"), Object.keys(e.commands).length ? `A line may be: ${Object.keys(e.commands).join(", ")}.` : "");
}

async function enter(answer) {
  const { asks } = held.console.entries;
  try { await post("enter", { asks, ...answer }, token); handAsks = asks; $("hand-refused").textContent = ""; }
  catch (error) { put($("hand-refused"), `Not taken: ${error.message}`); }
}
$("hand-form").onsubmit = event => {
  event.preventDefault();
  const fields = Object.fromEntries([...$("hand-fields").querySelectorAll("input")].map(i => [i.name, i.value.trim()]));
  if (held.console.entries && held.console.entries.fields.length) enter({ fields });
};
$("hand-enter").onclick = () => enter({ text: "" });
$("hand-line-send").onclick = () => { if ($("hand-line").value.trim()) enter({ text: $("hand-line").value.trim() }); };
$("hand-line").onkeydown = event => { if (event.key === "Enter") { event.preventDefault(); $("hand-line-send").click(); } };
