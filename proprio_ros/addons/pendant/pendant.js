// STOP is a request of its own: it needs nothing else of the page to be well.
const stop = () => fetch("/stop", {method: "POST", keepalive: true});
const isStop = (event) => event.target.closest && event.target.closest(".stop");
const writes = (element) => element.matches("textarea, input:not([type]), input[type=text]");
addEventListener("click", (event) => { if (isStop(event)) stop(); }, true);
// before anything else hears it: no button that has the focus may take the space bar for a click
for (const kind of ["keydown", "keyup"]) {
  addEventListener(kind, (event) => {
    if (event.code !== "Space" || writes(event.target)) return;
    event.preventDefault();
    event.stopImmediatePropagation();
    if (kind === "keydown" && !event.repeat) stop();
  }, true);
}
// the library draws a scene on after it has gone, as often as it is told, and keeps its place on the graphics card
const endWhenGone = (id) => {
  const scene = getElement(id);
  const timer = setInterval(() => {
    if (!scene.renderer || scene.$el.isConnected) return;
    clearInterval(timer);
    scene.$.props.fps = 1e-6;
    scene.renderer.dispose();
    scene.renderer.forceContextLoss();
  }, 1000);
};
// a file goes as it is, to a folder of its own; what is refused is said in one sentence
async function sendRecording(file, most) {
  if (file.size > most) return `${file.name}: larger than ${most / 2 ** 20} MiB; copy it into the folder instead`;
  try {
    return await (await fetch("/upload?name=" + encodeURIComponent(file.name), {method: "POST", body: file})).text();
  } catch { return `${file.name}: was not taken`; }
}
