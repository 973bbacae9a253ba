// Saves gauges, each as a table.

import { $, state } from "./common.js";

export const fileName = (ending) => `${(state.scene?.name || "mpsim").replace(/[^\w-]+/g, "_")}-${state.picture?.frame ?? 0}${ending}`;

/** Download a file, and say so. */
export function download(blob, name) {
  const link = document.createElement("a");
  [link.href, link.download] = [URL.createObjectURL(blob), name];
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 60000);
  $("keep-note").textContent = `${name}, ${Math.max(Math.round(blob.size / 1000), 1)} kB`;
}

const table = (columns) => {
  const names = Object.keys(columns), rows = columns[names[0]]?.length ?? 0;
  const lines = Array.from({ length: rows }, (_, k) => names.map((name) => columns[name]?.[k] ?? "").join(","));
  return [names.join(","), ...lines, ""].join("\n");
};

/** The numbers of a gauge as CSV: its last readings, or its present chart. */
export function tableOf(name) {
  const { gauges, history } = state;
  if (name === "speeds") {
    const { edges, density, maxwell } = gauges?.speeds ?? { edges: [], density: [] };
    return table({ from: edges.slice(0, -1), to: edges.slice(1), density, maxwell: maxwell ?? [] });
  }
  if (name === "workers") {
    const each = gauges?.workers ?? [];
    return table({ worker: each.map((_, k) => k), ...Object.fromEntries((gauges?.phases ?? []).map((phase, k) => [phase, each.map((parts) => parts[k])])) });
  }
  const beside = name === "pressure" ? ["pressure_error", "bulk_pressure"] : [];
  return table(Object.fromEntries(["frame", "time", name, ...beside].map((each) => [each, history[each] ?? []])));
}

/** Give each gauge its button. */
export function offerSaving() {
  for (const place of document.querySelectorAll("aside figure, .gauges > div")) {
    const name = place.querySelector("dd")?.id || place.querySelector("canvas").id;
    const heading = place.querySelector("figcaption, dt"), button = document.createElement("button");
    Object.assign(button, { type: "button", className: "save", textContent: "CSV", title: "Save as CSV" });
    button.setAttribute("aria-label", `${heading.firstChild.textContent.trim()} as CSV`);
    button.onclick = () => download(new Blob([tableOf(name)], { type: "text/csv" }), fileName(`-${name}.csv`));
    heading.append(button);
  }
}
