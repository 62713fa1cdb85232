// The rows of one axis in arrays that grow to a bound, and what of them fits a chart.
import { unpacked } from "./packed.js";

const MOST = 120000;
const SINGLE = ["number", "time", "u", "counts", "innovation", "status", "state"];

// Root mean square and largest size of numbers.
export class Amount {
  constructor(values = []) {
    this.n = this.sum = this.largest = 0;
    for (const value of values) this.add(value);
  }

  add(value) {
    if (value === null || !Number.isFinite(value)) return;
    this.n++;
    this.sum += value * value;
    this.largest = Math.max(this.largest, Math.abs(value));
  }

  get rms() {
    return this.n ? Math.sqrt(this.sum / this.n) : NaN;
  }

  get most() {
    return this.n ? this.largest : NaN;
  }
}

export class Columns {
  constructor(parameters) {
    this.names = [...SINGLE];
    for (let j = 0; j < parameters; j++) this.names.push(`theta${j}`, `std${j}`);
    this.parameters = parameters;
    this.clear();
  }

  clear() {
    this.size = 0;
    this.room = 4096;
    this.data = Object.fromEntries(this.names.map((name) => [name, new Float64Array(this.room)]));
  }

  // Rows after those that are here; returns whether there are any. Rows with earlier numbers are of an axis that began again.
  add(message) {
    const columns = Object.fromEntries(SINGLE.map((name) => [name, unpacked(message[name])]));
    message.theta.forEach((text, j) => (columns[`theta${j}`] = unpacked(text)));
    message.std.forEach((text, j) => (columns[`std${j}`] = unpacked(text)));
    const { number, time } = columns;
    if (!number.length) return false;
    if (this.size && number[0] <= this.data.number[this.size - 1]) this.clear();
    const first = this.afterJump(time, 0);
    this.append(columns, first, number.length - first);
    return true;
  }

  // A clock that was set back starts the charts anew: two rows of one time cannot stand in one chart.
  afterJump(time, first) {
    for (let k = time.length - 1; k >= first; k--) {
      const before = k > first ? time[k - 1] : this.end;
      if (time[k] < before) {
        this.clear();
        return k;
      }
    }
    return first;
  }

  append(columns, first, n) {
    if (n <= 0) return;
    if (this.size + n > MOST) this.forget(Math.max(n, MOST >> 2));
    while (this.size + n > this.room) this.grow();
    for (const name of this.names) this.data[name].set(columns[name].subarray(first), this.size);
    this.size += n;
  }

  forget(n) {
    n = Math.min(n, this.size);
    for (const name of this.names) this.data[name].copyWithin(0, n, this.size);
    this.size -= n;
  }

  grow() {
    this.room *= 2;
    for (const name of this.names) {
      const larger = new Float64Array(this.room);
      larger.set(this.data[name]);
      this.data[name] = larger;
    }
  }

  get end() {
    return this.size ? this.data.time[this.size - 1] : NaN;
  }

  get start() {
    return this.size ? this.data.time[0] : NaN;
  }

  // First row at or after a time.
  find(time) {
    let low = 0, high = this.size;
    while (low < high) {
      const middle = (low + high) >> 1;
      if (this.data.time[middle] < time) low = middle + 1;
      else high = middle;
    }
    return low;
  }

  // (first row, row behind the last) of what lies between two times, and one more on either side.
  between(from, to) {
    return [Math.max(0, this.find(from) - 1), Math.min(this.size, this.find(to) + 1)];
  }

  // What charts show between two times, in about `most` points at most, each of the rows of an equal time: estimates as
  // they are at its end, the input's mean, least and largest, the velocity over it, the largest innovation, all bits of
  // the status. The times begin where the clock's do, so that points stay what they are while the view moves on.
  thinned(from, to, most, resolution) {
    const [first, last] = this.between(from, to);
    const ends = this.ends(first, last, (to - from) / most);
    const made = {};
    for (const name of [...this.names, "low", "high", "velocity"]) made[name] = new Array(ends.length).fill(null);
    ends.forEach((end, k) => this.bin(made, k, k ? ends[k - 1] : first, end, resolution));
    return made;
  }

  // Rows behind the last of each stretch of time.
  ends(first, last, width) {
    const { time } = this.data;
    const found = [];
    for (let i = first + 1; i <= last; i++) {
      if (i === last || Math.floor(time[i] / width) !== Math.floor(time[i - 1] / width)) found.push(i);
    }
    return found;
  }

  // How much there is of input and velocity between two times, of every row rather than of points: the velocity of rows
  // that follow one another, for over a longer time it is a mean.
  motion(from, to, { dt, resolution }) {
    const { time, u, counts } = this.data;
    const input = new Amount(), velocity = new Amount();
    const last = this.find(to);
    for (let i = this.find(from); i < last; i++) {
      input.add(u[i]);
      const step = i ? time[i] - time[i - 1] : NaN;
      if (step < 1.5 * dt) velocity.add((resolution * (counts[i] - counts[i - 1])) / step);
    }
    return { input, velocity };
  }

  bin(made, k, start, end, resolution) {
    const { data } = this;
    for (const name of this.names) {
      const value = data[name][end - 1];
      made[name][k] = Number.isFinite(value) ? value : null;
    }
    let sum = 0, count = 0, low = Infinity, high = -Infinity, status = 0, largest = 0;
    for (let i = start; i < end; i++) {
      const u = data.u[i];
      if (Number.isFinite(u)) {
        sum += u;
        count++;
        if (u < low) low = u;
        if (u > high) high = u;
      }
      status |= data.status[i];
      if (Math.abs(data.innovation[i]) > Math.abs(largest)) largest = data.innovation[i];
    }
    made.u[k] = count ? sum / count : null;
    made.low[k] = count ? low : null;
    made.high[k] = count ? high : null;
    made.status[k] = status;
    made.innovation[k] = largest;
    const before = start - 1;
    if (before >= 0 && data.time[end - 1] > data.time[before]) {
      made.velocity[k] = (resolution * (data.counts[end - 1] - data.counts[before])) / (data.time[end - 1] - data.time[before]);
    }
  }
}
