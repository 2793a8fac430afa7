// The files of a folder that was dropped, without those of its folders.
async function filesIn(folder) {
  const reader = folder.createReader(), files = [];
  for (;;) {  // a browser hands out at most a hundred at a time
    const some = await new Promise((found, failed) => reader.readEntries(found, failed));
    if (!some.length) return files;
    for (const entry of some.filter((one) => one.isFile)) files.push(await new Promise((found, failed) => entry.file(found, failed)));
  }
}

// Send what was dropped to the bench, files together and each folder: what becomes of them, the element hears as an event.
async function benchDropped(element, items) {
  const entries = Array.from(items, (item) => item.webkitGetAsEntry()), files = Array.from(items, (item) => item.getAsFile());
  const folders = entries.filter((entry) => entry && entry.isDirectory);  // asked before the first wait: then the list is empty
  await benchUpload(element, files.filter((file, k) => file && !(entries[k] && entries[k].isDirectory)));
  for (const folder of folders) await benchUpload(element, await filesIn(folder), folder.name);
}

// Send one file: after two seconds with per cent, and a button that cancels it; return the answer.
function benchSend(place, file, element) {
  const request = new XMLHttpRequest(), shown = document.createElement("div"), cancel = document.createElement("button"), began = performance.now();
  const bar = document.createElement("progress"), answered = (error) => ({ error });
  Object.assign(cancel, { type: "button", textContent: "Cancel" });
  cancel.addEventListener("click", () => request.abort());
  bar.setAttribute("aria-label", `Sent of ${file.name}`);
  shown.className = "row";
  request.upload.addEventListener("progress", ({ loaded, total }) => {
    if (performance.now() - began < 2000) return;
    if (!shown.isConnected) element.parentElement.append(shown);
    Object.assign(bar, { max: total, value: loaded });
    shown.replaceChildren(bar, `${Math.floor(100 * loaded / total)} % of ${file.name} `, cancel);
  });
  return new Promise((found) => {
    const end = (answer) => { shown.remove(); found(answer); };
    request.addEventListener("load", () => { try { end(JSON.parse(request.responseText)); } catch { end(answered("upload: the bench refused the file; load the page again")); } });
    request.addEventListener("error", () => end(answered("upload: the file did not arrive; send it again")));
    request.addEventListener("abort", () => end(answered(`upload: ${file.name} was cancelled`)));
    request.open("POST", place);
    request.send(file);
  });
}

// Send files to the bench, one after the other; several that come together may be one recording.
async function benchUpload(element, files, folder = "") {
  const together = folder || files.length > 1, group = together ? crypto.getRandomValues(new Uint32Array(2)).join("") : "";
  const name = folder || Array.from(files, (file) => file.name.split(".")[0]).sort().slice(0, 2).join(", "), arrived = [];
  for (const file of files) {
    element.dispatchEvent(new CustomEvent("sending", { detail: { name: file.name } }));
    const asked = new URLSearchParams(together ? { name: file.name, group, folder: name } : { name: file.name });
    const answer = await benchSend("/upload?" + asked, file, element);
    if (together && answer.file) arrived.push(answer.file);
    else if (!(folder && answer.error)) element.dispatchEvent(new CustomEvent("sent", { detail: { name: file.name, ...answer } }));
  }
  const detail = arrived.length ? { name, files: arrived } : { name, error: `upload: wanted recordings in ${name}, got none; choose files` };
  if (arrived.length || folder) element.dispatchEvent(new CustomEvent("sent", { detail }));
}
