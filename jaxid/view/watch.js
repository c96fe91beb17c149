"use strict";
// A recording while it is made: channels as they come, and what the last look at them found.
const said = document.getElementById("said");
const told = document.getElementById("told");
let drawn = "";  // names of the channels that are drawn

async function ask(name) {
  const found = await (await fetch(name)).json();
  if (found.error) throw new Error(found.error);
  return found;
}

function element(kind, text, more) {
  const made = Object.assign(document.createElement(kind), more || {});
  if (text !== undefined) made.textContent = text;
  return made;
}

function table(caption, heads, rows) {
  const made = element("table");
  made.append(element("caption", caption));
  const head = element("tr");
  heads.forEach(name => head.append(element("th", name, {scope: "col"})));
  made.append(head);
  for (const row of rows) {
    const line = element("tr");
    row.forEach(cell => line.append(element("td", cell)));
    made.append(line);
  }
  return made;
}

async function channels() {
  const found = await ask("channels");
  const names = Object.keys(found).join("\n");
  if (!names) return;
  if (names !== drawn) {
    const {item} = await ask("plots");
    if (item === null) return;
    document.getElementById("plots").replaceChildren();
    await Bokeh.embed.embed_item(item, "plots");
    drawn = names;
    return;
  }
  for (const [name, columns] of Object.entries(found))
    for (const shown of Bokeh.documents) {
      const source = shown.get_model_by_name(name);
      if (source) source.data = columns;
    }
}

function sentence(text) {
  return text && text[0].toUpperCase() + text.slice(1) + (text.endsWith(".") ? "" : ".");
}

async function findings() {
  const found = await ask("told");
  const length = found.seconds === undefined ? "" : `, ${found.seconds.toFixed(1)} s`;
  said.className = found.enough ? "enough" : "";
  const verdict = found.enough ? "Enough: every number is known." : found.waiting || "";
  said.textContent = `${sentence(found.state + length)} ${sentence(verdict)}`;
  told.replaceChildren();
  if (found.numbers)
    told.append(table(`Numbers by now: known to within ${100 * found.share} % of itself, or of the largest in its unit`, ["number", "value", "known"],
      found.numbers.map(n => [n.name, n.text, n.known ? "yes" : "not yet"])));
  if (found.excitation)
    told.append(table("Motion so far", ["channel", "range", "turned round"],
      found.excitation.map(e => [e.channel, `${e.range.toPrecision(3)} ${e.unit}`, e.turns === 1 ? "once" : `${e.turns} times`])));
  if (found.findings) {
    told.append(element("h2", "What the recording says about itself"));
    const list = element("ul");
    (found.findings.length ? found.findings : ["Nothing to mend was found."]).forEach(text => list.append(element("li", text)));
    told.append(list);
  }
}

async function again() {
  try {
    await findings();
    await channels();
  } catch (error) {
    said.className = "";
    said.textContent = `This page is no longer served (${error.message}). To see the recording again: jaxid watch and its folder.`;
  }
  setTimeout(again, 1000);
}

window.addEventListener("load", again);
