// The emergency stop goes straight to the process that stands by at the table, and to the bench as well: whichever is first. It waits for
// no socket of the page. Escape does the same wherever the focus is.
document.addEventListener("submit", (event) => {
  if (event.target.id !== "bench-stop") return;
  event.preventDefault();
  const form = event.target, button = form.querySelector("button"), label = button.textContent;
  const post = (place, mode) => fetch(place, { method: "POST", mode, redirect: mode === "no-cors" ? "follow" : "manual", keepalive: true });
  const direct = form.dataset.place ? [post(`${location.protocol}//${location.hostname}${form.dataset.place}`, "no-cors")] : [];
  const sent = [...direct, post("/stop", "same-origin")];
  button.textContent = "Stopping";
  Promise.any(sent).then(() => setTimeout(() => { button.textContent = label; }, 3000), () => form.submit());
});
document.addEventListener("keydown", (event) => {
  const form = document.getElementById("bench-stop");
  if (event.key === "Escape" && form && form.checkVisibility()) form.requestSubmit();
}, true);

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
