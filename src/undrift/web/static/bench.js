// The emergency stop is sent by itself: it waits for no socket of the page and shows at once that it was sent.
document.addEventListener("submit", (event) => {
  if (event.target.id !== "bench-stop") return;
  event.preventDefault();
  const button = event.target.querySelector("button");
  button.textContent = "Stopping";
  fetch("/stop", { method: "POST", redirect: "manual", keepalive: true })
    .then(() => { button.textContent = "Stopped"; })
    .catch(() => { button.textContent = "Emergency stop"; event.target.submit(); });
});

// Send files to the bench, one after the other; what becomes of each is told to the element as an event.
async function benchUpload(element, files) {
  for (const file of files) {
    element.dispatchEvent(new CustomEvent("sending", { detail: { name: file.name } }));
    let answer;
    try {
      const response = await fetch("/upload?name=" + encodeURIComponent(file.name), { method: "POST", body: file });
      answer = await response.json();
    } catch (error) {
      answer = { error: "upload: the file did not arrive; send it again" };
    }
    element.dispatchEvent(new CustomEvent("sent", { detail: { name: file.name, ...answer } }));
  }
}
