"use strict";
// Results side by side: a run is chosen, effects are switched, and the free runs are drawn anew.
const controls = document.getElementById("controls");
const said = document.getElementById("said");
let about = null;

async function ask(name, parameters) {
  const answer = await fetch(`${name}?${new URLSearchParams(parameters)}`);
  const found = await answer.json();
  if (found.error) throw new Error(found.error);
  return found;
}

function chosen() {
  const off = about.results.map((_, k) => [...controls.querySelectorAll(`input[data-result="${k}"]:not(:checked)`)]
    .map(box => box.value));
  return {run: controls.querySelector("select").value, off: JSON.stringify(off)};
}

function tell(errors) {
  const lines = Object.entries(errors).map(([channel, values]) =>
    `${channel}: ` + values.map((v, k) => `${about.results[k].name} ${v.toPrecision(3)} ${about.units[channel]}`).join(", "));
  said.textContent = `rms error, ${lines.join("; ")}`;
}

async function draw() {
  said.textContent = "Simulating …";
  const found = await ask("plots", chosen());
  document.getElementById("plots").replaceChildren();
  await Bokeh.embed.embed_item(found.item, "plots");
  tell(found.rms);
}

async function redraw() {
  said.textContent = "Simulating …";
  const found = await ask("series", chosen());
  for (const [channel, simulated] of Object.entries(found.simulated)) {
    simulated.forEach((columns, number) => {
      for (const shown of Bokeh.documents) {
        const source = shown.get_model_by_name(`${channel}/${number}`);
        if (source) source.data = {...source.data, ...columns};
      }
    });
  }
  tell(found.rms);
}

function failed(error) { said.textContent = error.message; }

function element(kind, text, more) {
  const made = Object.assign(document.createElement(kind), more || {});
  if (text) made.textContent = text;
  return made;
}

async function begin() {
  said.textContent = "Reading the results and simulating for the first time: half a minute, more on a busy computer …";
  about = await ask("about", {});
  const runs = element("select");
  about.runs.forEach((name, k) => runs.append(element("option", name, {value: k})));
  const label = element("label", "Run ");
  label.append(runs);
  controls.append(label);
  const off = new Set(new URLSearchParams(location.search).getAll("off"));
  about.results.forEach((result, k) => {
    const group = element("fieldset");
    const legend = element("legend");
    const mark = element("i");
    mark.style.background = result.color;
    legend.append(mark, result.name);
    group.append(legend);
    for (const effect of result.effects) {
      const line = element("label");
      const box = element("input", "", {type: "checkbox", checked: !off.has(effect), value: effect});
      box.dataset.result = k;
      box.addEventListener("change", () => redraw().catch(failed));
      line.append(box, " " + effect);
      group.append(line);
    }
    if (!result.effects.length) group.append(element("span", "no effect added"));
    controls.append(group);
  });
  runs.addEventListener("change", () => draw().catch(failed));
  for (const note of about.notes) document.getElementById("told").append(element("p", note));
  await draw();
}

window.addEventListener("load", () => begin().catch(failed));
