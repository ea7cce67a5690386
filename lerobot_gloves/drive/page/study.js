// What the page shows of a study: how far it is, and in the end what came of it.

const at = (id) => document.getElementById(id);

function row(kind, cells) {
  const line = document.createElement("tr");
  cells.forEach((text, i) => {
    const cell = document.createElement(kind === "th" || i === 0 ? "th" : "td");
    if (cell.tagName === "TH") cell.scope = kind === "th" ? "col" : "row";
    cell.textContent = text;
    line.append(cell);
  });
  return line;
}

export function tell(study) {
  document.body.classList.toggle("study", Boolean(study));
  if (!study) return;
  const { episode, of, results } = study;
  at("progress").textContent = results ? `Study: all ${of} episodes are done.` : `Study: episode ${episode} of ${of}.`;
  at("results").hidden = !results;
  if (!results || at("results").dataset.told) return;
  at("results").dataset.told = "yes";
  at("table").tHead.replaceChildren(row("th", results.header));
  at("table").tBodies[0].replaceChildren(...results.lines.map((line) => row("td", line)));
  at("caption").textContent = results.caption;
  at("paths").src = results.picture;
  at("folder").textContent = `In ${results.folder}: this table, this picture and the dataset. Nothing has left this computer.`;
}
