// The ragged form (tSGM, paper 004 section 5.2.4): every pixel has disparities of its own, some blocks of 16. A pixel
// leaves a message to each of its four successors, which is all they need of it:
//   message(d) = min(L(d), L(d - 1) + P1, L(d + 1) + P1, min L + P2) - min L,   P2 outside its range.
// Two guard blocks of P2 enclose each message, so any offset between two ranges is one unaligned load.

// What W, the vectors of long ranges, need where they are single blocks. Lanes from n on do not count.
static inline B load_first(const u8* p, int, B) { return B::load(p); }

// Lanes `at` and on of a message of `length` lanes, P2 outside.
static inline B told(const u8* source, int at, int length, B) {
  return B::load(source + clamped(at, -kBlock, length));
}

static inline B message(B line, B least, B small, B large) {
  const B near = adds(vmin(before(line), after(line)), small);
  return vmin(sub(vmin(line, near), least), large);
}

// Where the three messages from the row before begin for each pixel.
static void ragged_sources(const Job& job, int y, int step, bool top, const Row& before, Scratch& s) {
  if (top) {
    for (int k = 0; k < 3; ++k) {
      for (int x = 0; x < job.width; ++x) s.from[k][x] = kBlock;
    }
    return;
  }
  const i16* first = job.first + static_cast<std::size_t>(y) * job.width;
  for (int k = 0; k < 3; ++k) {
    const int shift = step * (k - 1), low = shift < 0 ? -shift : 0;
    const int high = shift > 0 ? job.width - shift : job.width;
    const std::ptrdiff_t there = (static_cast<std::ptrdiff_t>(y) - step) * job.width + shift;
    const i16* from = job.first + there;
    const u8* blocks = job.blocks + there;
    const u32* at = before.at + shift;
    u32* out = s.from[k];
    for (int x = low; x < high; ++x) {
      const int offset = first[x] - from[x], n = kBlock * blocks[x];
      const int less = offset < n ? offset : n;
      out[x] = at[x] + static_cast<u32>(less > -kBlock ? less : -kBlock);
    }
    if (low > 0) out[0] = kBlock;
    if (high < job.width) out[job.width - 1] = kBlock;
  }
}

static void ragged_layout(const Job& job, int y, Row& row) {
  const u8* blocks = job.blocks + static_cast<std::size_t>(y) * job.width;
  u32 at = kBlock;
  for (int x = 0; x < job.width; ++x) {
    row.at[x] = at;
    at += static_cast<u32>(kBlock * (blocks[x] + 1));
  }
  const B guard = B::set1(job.large);
  for (int k = 0; k < 3; ++k) guard.store(row.path[k]);
}

constexpr int kFetched = 1024;  // bytes by which costs and sums are fetched before they are needed on the way back

struct Place {
  int x, y, first, n;
};

// The neighbour in the row: its range, and its message in memory with guards on both sides; while it has one block
// only, the message stays in a register, as P2 less it, so that lanes shifted in count as P2.
struct Beside {
  int first, n;
  B inverse;
};

template <int DIR>
static u32 ragged_long(const Sweep& w, const Row& before_row, const Row& here, const Place& p, const Beside& beside,
                       u8* cost, u8* sum) {
  const Job& job = *w.job;
  Scratch& s = *w.scratch;
  if (DIR > 0) costs(job, s, p.y, p.x, p.first, p.n, s.cost, W());
  const u8* from = DIR > 0 ? s.cost : cost;
  const W small = W::set1(job.small), large = W::set1(job.large), far = W::set1(kFar), zero = W::set1(0);
  W low[4] = {far, far, far, far};
  const u8* source[4];
  int offset[4], length[4];
  for (int k = 0; k < 3; ++k) {
    const int x = clamped(p.x + DIR * (k - 1), 0, job.width - 1), y = clamped(p.y - DIR, 0, job.height - 1);
    const std::size_t at = static_cast<std::size_t>(y) * job.width + x;
    source[k] = before_row.path[k] + before_row.at[x];
    offset[k] = p.first - job.first[at];
    length[k] = kBlock * job.blocks[at];
  }
  source[3] = s.beside[0];
  offset[3] = p.first - beside.first;
  length[3] = beside.n;
  RunningW best;
  for (int b = 0; b < p.n; b += W::N) {
    const int n = p.n - b;
    const W c = load_first(from + b, n, far);
    if (DIR > 0) store_first(c, cost + b, n);
    W part[4];
    for (int k = 0; k < 4; ++k) {
      const u8 penalty = s.penalty[k][p.x];
      part[k] = penalty ? vmin(told(source[k], offset[k] + b, length[k], large), W::set1(penalty)) : zero;
      const W line = adds(c, part[k]);
      line.store(s.lines[k] + b);
      low[k] = vmin(low[k], line);
    }
    const W one = add(part[0], part[1]), two = add(part[2], part[3]);
    if (DIR > 0) {
      store_first(avg(one, two), sum + b, n);
    } else {
      const W::Sum all = add(pair_sum(one, two), forward_sum(c, load_first(sum + b, n, zero)));
      all.store(s.total + b);
      best.see(all, b);
    }
  }
  u8 least[4];
  least_of_four(low, least);
  for (int k = 0; k < 4; ++k) {
    u8* to = k < 3 ? here.path[k] + here.at[p.x] : s.beside[0];
    const W base = W::set1(least[k]);
    W previous = far, current = W::load(s.lines[k]);
    for (int b = 0; b < p.n; b += W::N) {  // whole vectors only: shifted loads would wait for the stores above
      const W next = b + W::N < p.n ? W::load(s.lines[k] + b + W::N) : far;
      const W near = adds(vmin(before(previous, current), after(current, next)), small);
      const W told = vmin(sub(vmin(current, near), base), large);
      if (k < 3) store_first(told, to + b, p.n - b);
      else told.store(to + b);
      previous = current;
      current = next;
    }
    B::set1(job.large).store(to + p.n);
  }
  return DIR > 0 ? 0 : best.result();
}

// One block of disparities, the usual case: nothing but registers and one load for each message.
template <int DIR>
static inline u32 ragged_short(const Sweep& w, const Row& before_row, const Row& here, const Place& p, Beside& beside,
                               const u8* cost, u8* sum) {
  const Job& job = *w.job;
  Scratch& s = *w.scratch;
  const B small = B::set1(job.small), large = B::set1(job.large), c = B::load(cost);
  const u32 at = here.at[p.x];
  B part[4];
  if (beside.n == kBlock) {
    part[3] = sub(large, shifted(beside.inverse, clamped(p.first - beside.first, -kBlock, kBlock)));
  } else {
    part[3] = B::load(s.beside[0] + clamped(p.first - beside.first, -kBlock, beside.n));
  }
  part[3] = vmin(part[3], B::set1(s.penalty[3][p.x]));
  const B line = add(c, part[3]);
  beside = {p.first, kBlock, sub(large, message(line, hmin_all(line), small, large))};
  for (int k = 0; k < 3; ++k) {
    part[k] = vmin(B::load(before_row.path[k] + s.from[k][p.x]), B::set1(s.penalty[k][p.x]));
    const B l = add(c, part[k]);
    message(l, hmin_all(l), small, large).store(here.path[k] + at);
    large.store(here.path[k] + at + kBlock);
  }
  const B one = add(part[0], part[1]), two = add(part[2], part[3]);
  if (DIR > 0) {
    avg(one, two).store(sum);
    return 0;
  }
  const Sum16 all = add(pair_sum(one, two), forward_sum(c, B::load(sum)));
  all.store(s.total);
  return argmin(all);
}

static inline void ragged_cost(const Sweep& w, const Place& p, u8* cost) {  // of one block
  const Job& job = *w.job;
  const Scratch& s = *w.scratch;
  const int j0 = job.right_width - 1 - p.x + p.first;
  if (j0 >= 0 && j0 + kBlock <= job.right_width) {
    const u8* left = job.left + p.y * job.left_stride + p.x;
    const B census = hamming(s.right_census + j0, s.left_census[p.x]);
    with_greys(job, census, greys_of(job, left), job.right + p.y * job.right_stride + j0).store(cost);
  } else {
    costs(job, s, p.y, p.x, p.first, p.n, cost, B());
  }
}

template <int DIR>
static void ragged_row(const Sweep& w, int row) {
  const Job& job = *w.job;
  Scratch& s = *w.scratch;
  const int y = DIR > 0 ? row : job.height - 1 - row, ring = w.threads + 1;
  Row& here = w.ring[row % ring];
  const Row& before_row = w.ring[(row + ring - 1) % ring];
  const i16* first = job.first + static_cast<std::size_t>(y) * job.width;
  const u8* blocks = job.blocks + static_cast<std::size_t>(y) * job.width;
  begin_row<DIR>(w, y, row == 0, s);
  ragged_layout(job, y, here);
  const B large = B::set1(job.large);
  large.store(s.beside[0] - kBlock);
  Beside beside = {0, 0, B::set1(0)};
  u64 at = job.row_offset[DIR > 0 ? y : y + 1];
  for (int i = 0; i < job.width; ++i) {
    const int x = DIR > 0 ? i : job.width - 1 - i;
    if (i % 32 == 0) {
      publish(w, row, i);
      wait_for(w, row - 1, i + 34);  // 32 pixels, and one beyond them
      if (i == 0) ragged_sources(job, y, DIR, row == 0, before_row, s);
    }
    const Place p = {x, y, first[x], kBlock * blocks[x]};
    if (DIR < 0) {
      at -= static_cast<u64>(p.n);
      for (int b = 0; b < p.n; b += 64) {
        __builtin_prefetch(job.cost + at + b - kFetched);
        __builtin_prefetch(job.sum + at + b - kFetched);
      }
    }
    u8* cost = job.cost + at;
    u8* sum = job.sum + at;
    if (DIR > 0) {
      at += static_cast<u64>(p.n);
      if (p.n == kBlock) ragged_cost(w, p, cost);
    }
    u32 key;
    if (p.n == kBlock) {
      key = ragged_short<DIR>(w, before_row, here, p, beside, cost, sum);
    } else {
      if (beside.n == kBlock) {  // the long form reads it from memory
        sub(large, beside.inverse).store(s.beside[0]);
        large.store(s.beside[0] + kBlock);
      }
      key = ragged_long<DIR>(w, before_row, here, p, beside, cost, sum);
      beside.first = p.first;
      beside.n = p.n;
    }
    if (DIR < 0) {
      if (p.n == kBlock) keep(w, s, x, p.first, p.n, key, Sum16());
      else keep(w, s, x, p.first, p.n, key, W::Sum());
    }
  }
  if (DIR < 0) finish_row(w, y, s);
  publish(w, row, job.width);
}
