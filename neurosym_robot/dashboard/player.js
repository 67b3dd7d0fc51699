// Which moment is shown: following what is live, playing, paused, or wherever the user went.

class Player {
  constructor(recording, live, changed) {
    this.recording = recording;
    this.live = live; // whether more may come
    this.following = live;
    this.playing = !live;
    this.index = 0;
    this.fraction = 0; // of the way to the next moment
    this.speed = 1;
    this.changed = changed;
    this.tick = this.tick.bind(this);
    if (this.playing) requestAnimationFrame(this.tick);
  }

  get moment() { return this.recording.moments[this.index]; }
  get atEnd() { return this.index >= this.recording.length - 1; }
  get behind() { return (this.recording.moments.at(-1)?.t ?? 0) - (this.moment?.t ?? 0); }

  // A moment was added, and `gone` old ones let go.
  grew(gone) {
    this.index = this.following ? this.recording.length - 1 : Math.max(0, this.index - gone);
    if (this.following) this.changed();
  }

  go(index) {
    this.following = false;
    this.index = Math.min(Math.max(index, 0), this.recording.length - 1);
    this.fraction = 0;
    this.changed();
  }

  // On or back by so many forecasts; where there are none, by moments.
  skip(count) {
    this.pause();
    const { moments, length } = this.recording;
    const direction = Math.sign(count);
    let index = this.index;
    for (let left = Math.abs(count); left > 0; left -= 1) {
      const from = index;
      do index += direction; while (index > 0 && index < length - 1 && !moments[index].step);
      if (index < 0 || index >= length) { index = from; break; }
    }
    this.go(index);
  }

  pause() {
    this.following = this.playing = false;
    this.changed();
  }

  follow() {
    this.following = this.live;
    this.playing = false;
    this.index = Math.max(0, this.recording.length - 1);
    this.fraction = 0;
    this.changed();
  }

  toggle() {
    if (this.playing || this.following) return this.pause();
    if (this.atEnd && this.live) return this.follow();
    if (this.atEnd) this.index = this.fraction = 0;
    this.playing = true;
    this.drawn = null;
    requestAnimationFrame(this.tick);
    this.changed();
  }

  // Nothing more comes.
  end() {
    this.live = this.following = false;
    this.changed();
  }

  tick(now) {
    if (!this.playing) return;
    let seconds = this.drawn ? (Math.min(now - this.drawn, 250) / 1000) * this.speed : 0;
    this.drawn = now;
    const { moments } = this.recording;
    while (!this.atEnd) {
      // A silence is not sat through.
      const gap = Math.min(moments[this.index + 1].t - moments[this.index].t, 1);
      const left = gap * (1 - this.fraction);
      if (seconds < left) {
        this.fraction += seconds / gap;
        break;
      }
      seconds -= left;
      this.index += 1;
      this.fraction = 0;
    }
    if (this.atEnd) {
      this.fraction = 0;
      this.playing = false;
      this.following = this.live;
    }
    this.changed();
    requestAnimationFrame(this.tick);
  }

  // Where people are now: between two moments, between their two places.
  places() {
    const { moment, fraction } = this;
    if (!moment) return new Map();
    const next = this.recording.moments[this.index + 1];
    if (!fraction || next.t - moment.t > 1) return moment.at;
    return new Map([...moment.at].map(([id, [x, y]]) => {
      const [a, b] = next.at.get(id) ?? [x, y];
      return [id, [x + fraction * (a - x), y + fraction * (b - y)]];
    }));
  }
}
