// Where the data comes from: the page itself, or the stream of who serves it.

function openFile(lines) {
  const app = new App(JSON.parse(lines[0]), false);
  lines.slice(1).forEach((line) => app.add(line));
  new Controls(app);
}

// Follow the stream; what was missed is sent again, and after a restart everything is new.
function openStream() {
  const source = new EventSource("events");
  let introduction = null;
  let app = null;
  say(find("status"), "connecting");
  source.addEventListener("introduction", (event) => { introduction = JSON.parse(event.data); });
  source.addEventListener("anew", () => {
    if (app) return location.reload();
    app = new App(introduction, true);
    new Controls(app);
  });
  source.onmessage = (event) => app.add(event.data);
  source.addEventListener("end", () => {
    source.close();
    app.ended = true;
    app.player.end();
  });
  source.onopen = () => {
    if (!app) return;
    app.lost = false;
    app.redraw();
  };
  source.onerror = () => {
    if (!app) return say(find("status"), "no connection, trying again");
    app.lost = true;
    app.redraw();
  };
}

const embedded = find("recording").textContent.trim();
if (embedded) openFile(embedded.split("\n")); else openStream();
