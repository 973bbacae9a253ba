// Saves gauges: each as a table (CSV) or a picture (PNG), by its buttons, or dragged out of the page.

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

/** The canvas of a gauge on white, with its name and value above. */
function pictureOf(place, canvas) {
  const found = document.createElement("canvas"), scale = window.devicePixelRatio || 1, head = 24 * scale;
  [found.width, found.height] = [canvas.width + 16 * scale, canvas.height + head + 8 * scale];
  const c = found.getContext("2d");
  c.fillStyle = "#fff";
  c.fillRect(0, 0, found.width, found.height);
  c.fillStyle = "#16191d";
  c.font = `${13 * scale}px system-ui, "DejaVu Sans", sans-serif`;
  const name = place.dataset.title, value = place.querySelector("dd")?.textContent ?? "";
  c.fillText(`${name} ${value}`, 8 * scale, 16 * scale);
  c.drawImage(canvas, 8 * scale, head);
  return found;
}

/** Give each gauge its buttons, and let it be dragged out. */
export function offerSaving() {
  for (const place of document.querySelectorAll("aside figure, .gauges > div")) {
    const canvas = place.querySelector("canvas"), name = place.querySelector("dd")?.id || canvas.id;
    const heading = place.querySelector("figcaption, dt"), buttons = document.createElement("span");
    place.dataset.title = heading.firstChild.textContent.trim();
    buttons.className = "save";
    const save = {
      CSV: () => download(new Blob([tableOf(name)], { type: "text/csv" }), fileName(`-${name}.csv`)),
      PNG: () => pictureOf(place, canvas).toBlob((blob) => download(blob, fileName(`-${name}.png`)), "image/png"),
    };
    for (const [kind, act] of Object.entries(save)) {
      const button = document.createElement("button");
      Object.assign(button, { type: "button", textContent: kind, title: `Save as ${kind}`, onclick: act });
      button.setAttribute("aria-label", `${place.dataset.title} as ${kind}`);
      buttons.append(button);
    }
    heading.append(buttons);
    place.draggable = true;
    place.addEventListener("dragstart", (event) => {
      const onPicture = document.elementFromPoint(event.clientX, event.clientY) === canvas;
      (onPicture ? dragPicture : dragTable)(event.dataTransfer, onPicture ? pictureOf(place, canvas) : tableOf(name), name);
    });
  }
}

function dragTable(data, text, name) {
  data.setData("text/plain", text);
  data.setData("text/csv", text);
  data.setData("DownloadURL", `text/csv:${fileName(`-${name}.csv`)}:data:text/csv,${encodeURIComponent(text)}`);
}

/** Uses a link, because `toBlob` would end too late for the drag. */
function dragPicture(data, canvas, name) {
  const link = canvas.toDataURL("image/png");
  data.setData("text/uri-list", link);
  data.setData("text/html", `<img src="${link}">`);
  data.setData("DownloadURL", `image/png:${fileName(`-${name}.png`)}:${link}`);
}
