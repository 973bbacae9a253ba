// The time line of a recording: a slider over its frames, one frame back, and following a growing file.

import { $, onButton, onKeys, state } from "./common.js";
import { paced } from "./edits.js";
import { send, takers } from "./connection.js";

let last = 0, dragged = false;
const line = $("timeline"), seek = paced((index) => send({ do: "seek", index }));

onButton("back", ",", () => { if (state.timeline?.index) send({ do: "seek", index: state.timeline.index - 1 }); });
onButton("follow", "l", () => { if (state.timeline) send({ do: "follow", value: !state.timeline.follow }); });
line.addEventListener("input", () => { dragged = true; seek(+line.value); });
line.addEventListener("change", () => { dragged = false; });

onKeys((key, event) => {
  if (!state.timeline || event.target.closest?.("input")) return null;
  return { Home: () => seek(0), End: () => seek(last) }[key];
});

takers.scene.push(({ recording }) => {
  document.documentElement.dataset.source = recording ? "recording" : "simulation";
});
takers.timeline.push((message) => {
  state.timeline = message;
  last = message.count - 1;
  line.max = Math.max(last, 1);
  line.disabled = last === 0;
  if (!dragged) line.value = message.index;
  const text = `${(message.index + 1).toLocaleString("en")} of ${message.count.toLocaleString("en")}`;
  $("timeline-text").textContent = text;
  line.setAttribute("aria-valuetext", text);
  $("back").disabled = message.index === 0;
  $("follow").setAttribute("aria-pressed", message.follow);
});
