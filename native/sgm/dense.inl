// The dense form: every pixel has the same disparities. A band of rows is matched together, each row kBehind pixels
// behind the one before it, so that path costs go from row to row within the first-level cache; only those of a band's
// last row are written to memory, where its first row has read already. Path costs of a pixel are stored as they are,
// with a vector of kFar between pixels, and the message to the next pixel is formed where it is read.

struct Source {
  const u8 *line, *least, *penalty;
};

// Pixels by which sums are fetched before they are needed: no hardware expects several rows backwards.
constexpr int kAhead = 4;

static inline int first_row(const Sweep& w, int band) {
  return static_cast<int>(static_cast<long long>(band) * w.job->height / w.bands);
}

template <int DIR>
static inline u32 dense_paths(const Job& job, const Source* from, u8* const* to, u8* least, const u8* cost, u8* sum,
                              u16* total) {
  const V small = V::set1(job.small);
  V low[4], jump[4], base[4];
  for (int k = 0; k < 4; ++k) {
    low[k] = V::set1(kFar);
    base[k] = V::set1(*from[k].least);
    jump[k] = adds(base[k], V::set1(*from[k].penalty));
  }
  const std::ptrdiff_t ahead = kAhead * static_cast<std::ptrdiff_t>(job.padded);
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
    const V one = add(part[0], part[1]), two = add(part[2], part[3]);
    if (DIR > 0) {
      const V half = avg(one, two);
      if (job.streamed) half.stream(sum + b);
      else half.store(sum + b);
    } else {
      __builtin_prefetch(sum + b - ahead);
      const V::Sum all = add(pair_sum(one, two), forward_sum(c, V::load(sum + b)));
      all.store(total + b);
      best.see(all, b);
    }
  }
  least_of_four(low, least);
  return DIR > 0 ? 0 : best.result();
}

// The i-th pixel of a row in the order of the sweep. `before` and `here` keep path costs at places i & mask.
template <int DIR>
static inline __attribute__((always_inline)) void dense_pixel(const Sweep& w, int y, int i, Scratch& s,
                                                              const Row* before, int before_mask, const Row& here,
                                                              int mask) {
  const Job& job = *w.job;
  const int x = DIR > 0 ? i : job.width - 1 - i, pitch = job.padded + V::N;
  const std::size_t cell = (static_cast<std::size_t>(y) * job.width + x) * job.padded;
  costs(job, s, y, x, job.low, job.padded, s.cost, V());
  if (job.count < job.padded) std::memset(s.cost + job.count, kFar, job.padded - job.count);
  Source from[4];
  for (int k = 0; k < 3; ++k) {
    const std::size_t at = clamped(i + k - 1, 0, job.width - 1) & before_mask;
    from[k] = {before ? before->path[k] + V::N + at * pitch : s.zero, before ? before->least + 4 * at + k : s.zero,
               s.penalty[k] + x};
  }
  from[3] = {i ? s.beside[i & 1] : s.zero, i ? here.least + 4 * static_cast<std::size_t>((i - 1) & mask) + 3 : s.zero,
             s.penalty[3] + x};
  const std::size_t place = i & mask, at = V::N + place * pitch;
  u8* to[4] = {here.path[0] + at, here.path[1] + at, here.path[2] + at, s.beside[~i & 1]};
  const u32 key = dense_paths<DIR>(job, from, to, here.least + 4 * place, s.cost, job.sum + cell, s.total);
  if (DIR < 0) {
    keep(w, s, x, job.low, job.count, key, V::Sum());
  }
}

template <int DIR>
static void dense_band(const Sweep& w, int band) {
  const Job& job = *w.job;
  const int top = first_row(w, band), last = first_row(w, band + 1) - top - 1;
  const auto row_of = [&](int r) { return DIR > 0 ? top + r : job.height - 1 - top - r; };
  for (int r = 0; r <= last; ++r) begin_row<DIR>(w, row_of(r), top + r == 0, w.scratch[r]);
  const int end = job.width + kBehind * last;
  for (int t = 0; t < end; ++t) {
    if (t % 32 == 0) {
      publish(w, band, t - kBehind * last);
      wait_for(w, band - 1, t + 34);  // 32 pixels, and one beyond them
    }
    const int oldest = t < job.width ? 0 : (t - job.width) / kBehind + 1;
    for (int r = oldest; r <= last && kBehind * r <= t; ++r) {
      Scratch& s = w.scratch[r];
      const Row* before = top + r == 0 ? nullptr : r == 0 ? w.ring : &w.scratch[r - 1].near;
      dense_pixel<DIR>(w, row_of(r), t - kBehind * r, s, before, r == 0 ? -1 : kSlots - 1, r == last ? *w.ring : s.near,
                       r == last ? -1 : kSlots - 1);
    }
  }
  for (int r = 0; DIR < 0 && r <= last; ++r) finish_row(w, row_of(r), w.scratch[r]);
  publish(w, band, job.width);
}
