// The dense form: every pixel has the same disparities. Path costs of a pixel are stored as they are, with a vector of
// kFar between pixels, and the message to the next pixel is formed where it is read.

struct Source {
  const u8* line;
  u8 least, penalty;
};

template <int DIR>
static inline void dense_sources(const Job& job, const Scratch& s, const Row& before, const Source& beside, int x,
                                 Source* from) {
  const int pitch = job.padded + V::N;
  for (int k = 0; k < 3; ++k) {
    const int at = clamped(x + DIR * (k - 1), 0, job.width - 1);
    from[k] = {before.path[k] + V::N + static_cast<std::size_t>(at) * pitch, before.least[k][at], s.penalty[k][x]};
  }
  from[3] = {beside.line, beside.least, s.penalty[3][x]};
}

static inline void dense_cost(const Sweep& w, const Scratch& s, const u8* left_row, const u8* right_row, int x,
                              u8* cost) {
  const Job& job = *w.job;
  const int j0 = job.right_width - 1 - x + job.low;
  if (j0 >= 0 && j0 + job.padded <= job.right_width) {
    for (int b = 0; b < job.padded; b += V::N) {
      hamming_wide(s.right_census + j0 + b, s.left_census[x], static_cast<V*>(nullptr)).store(cost + b);
    }
  } else {
    cost_anywhere(job, s, x, job.low, job.padded, cost);
  }
  if (job.mode != CostMode::census) mix(job, left_row, right_row, x, job.low, job.count, cost);
  for (int d = job.count; d < job.padded; ++d) cost[d] = kFar;
}

template <int DIR>
static inline u32 dense_pixel(const Job& job, const Source* from, u8* const* to, u8* least, const u8* cost, u16* sum,
                              u16* total) {
  const V small = V::set1(job.small);
  V low[4], jump[4], base[4];
  for (int k = 0; k < 4; ++k) {
    const int over = from[k].least + from[k].penalty;
    low[k] = V::set1(kFar);
    base[k] = V::set1(from[k].least);
    jump[k] = V::set1(static_cast<u8>(over > 255 ? 255 : over));
  }
  Running best;
  for (int b = 0; b < job.padded; b += V::N) {
    const V c = V::load(cost + b);
    V part[4];
    for (int k = 0; k < 4; ++k) {
      const u8* p = from[k].line + b;
      const V near = adds(vmin(V::load(p - 1), V::load(p + 1)), small);
      part[k] = sub(vmin(vmin(V::load(p), jump[k]), near), base[k]);
      const V line = adds(c, part[k]);
      line.store(to[k] + b);
      low[k] = vmin(low[k], line);
    }
    const V::Sum four = pair_sum(add(part[0], part[1]), add(part[2], part[3]));
    if (DIR > 0) {
      four.store(sum + b);
    } else {
      const V::Sum all = add(add(four, V::Sum::load(sum + b)), eightfold(c));
      all.store(total + b);
      best.see(all, b);
    }
  }
  for (int k = 0; k < 4; ++k) least[k] = hmin(low[k]);
  return DIR > 0 ? 0 : best.result();
}

template <int DIR>
static void dense_row(const Sweep& w, int row) {
  const Job& job = *w.job;
  Scratch& s = *w.scratch;
  const int y = DIR > 0 ? row : job.height - 1 - row, ring = w.threads + 1, pitch = job.padded + V::N;
  const Row& here = w.ring[row % ring];
  const Row& before = w.ring[(row + ring - 1) % ring];
  const u8* left_row = job.left + y * job.left_stride;
  const u8* right_row = job.right + y * job.right_stride;
  const std::size_t start = static_cast<std::size_t>(y) * job.width;
  begin_row(w, y, DIR, row == 0, s);
  Source beside = {s.zero, 0, 0};
  for (int i = 0; i < job.width; ++i) {
    const int x = DIR > 0 ? i : job.width - 1 - i;
    if (i % 32 == 0) wait_for_row_before(w, row, i);
    u8* cost = job.cost + (start + x) * job.padded;
    u16* sum = job.sum + (start + x) * job.padded;
    if (DIR > 0) dense_cost(w, s, left_row, right_row, x, cost);
    Source from[4];
    dense_sources<DIR>(job, s, before, beside, x, from);
    const std::size_t at = V::N + static_cast<std::size_t>(x) * pitch;
    u8* line = s.beside[i & 1];
    u8* to[4] = {here.path[0] + at, here.path[1] + at, here.path[2] + at, line};
    u8 least[4];
    const u32 key = dense_pixel<DIR>(job, from, to, least, cost, sum, s.total);
    for (int k = 0; k < 3; ++k) here.least[k][x] = least[k];
    beside = {line, least[3], 0};
    if (DIR < 0) {
      keep(w, s, x, job.low, job.count, key);
      if (job.uniqueness > 0 && !unique(job, s.total, job.count, key)) s.best[x] = kNone;
    }
  }
  if (DIR < 0) finish_row(w, y, s);
  w.done[row].store(job.width, std::memory_order_release);
}
