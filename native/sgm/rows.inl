// What both forms do row by row: census, penalties, the winner and its sub-pixel part. Included once for each
// instruction set, inside its own namespace; no inline function of the standard library may enter here, or the linker
// could hand the version for one machine to all.

static inline int clamped(int x, int low, int high) { return x < low ? low : x > high ? high : x; }

static inline B hamming_wide(const u64* right, u64 left, B*) { return hamming(right, left); }

// One bit for each pixel of the window around the centre: 1 where it is not brighter. `side` -1 reads the window
// mirrored, so that bits of a mirrored image have the same meaning.
static void census_row(const u8* row, std::ptrdiff_t stride, const Job& job, int width, int side, Scratch& s,
                       u64* out) {
  const int bits = (2 * job.radius_x + 1) * (2 * job.radius_y + 1) - 1;
  for (int x = 0; x < width; x += V::N) {
    const V centre = V::load(row + x);
    V plane = V::set1(0);
    int bit = 0;
    for (int dy = -job.radius_y; dy <= job.radius_y; ++dy) {
      for (int dx = -job.radius_x; dx <= job.radius_x; ++dx) {
        if (dx == 0 && dy == 0) continue;
        const V is = below_or_equal(V::load(row + x + dy * stride + side * dx), centre);
        plane = sub(add(plane, plane), is);  // true is -1
        if (++bit % 8 == 0 || bit == bits) {
          plane.store(s.planes + ((bit - 1) / 8) * s.plane_stride + x);
          plane = V::set1(0);
        }
      }
    }
  }
  for (int x = 0; x < width; x += 16) interleave(s.planes + x, s.plane_stride, out + x);
}

// Adaptive P2 of a row towards the predecessors of its pixels on the four paths; 0 where there is none, which makes
// the path begin anew. Paths 0..2 come from the row before at x - step, x, x + step, path 3 from x - step.
static void penalties(const Job& job, int y, int step, bool top, Scratch& s) {
  const u8* here = job.left + y * job.left_stride;
  const u8* there = here - step * job.left_stride;
  const B table = B::load(job.large_by_step);
  for (int x = 0; x < job.width; x += B::N) {
    const B centre = B::load(here + x);
    for (int k = 0; k < 3; ++k) {
      const B g = absdiff(centre, B::load(there + x + (k - 1) * step));
      lookup(table, steps(g)).store(s.penalty[k] + x);
    }
    lookup(table, steps(absdiff(centre, B::load(here + x - step)))).store(s.penalty[3] + x);
  }
  const int begin = step > 0 ? 0 : job.width - 1, end = job.width - 1 - begin;
  s.penalty[0][begin] = s.penalty[2][end] = s.penalty[3][begin] = 0;
  if (top) {
    for (int k = 0; k < 3; ++k) {
      for (int x = 0; x < job.width; x += B::N) B::set1(0).store(s.penalty[k] + x);
    }
  }
}

// Costs of n disparities of pixel x from disparity `first` on, for any range: lanes outside the right image cost
// `outside`. j is the mirrored column of the first disparity.
static void cost_anywhere(const Job& job, const Scratch& s, int x, int first, int n, u8* cost) {
  const int j0 = job.right_width - 1 - x + first;
  for (int b = 0; b < n; b += B::N) {
    hamming(s.right_census + clamped(j0 + b, -kBlock, job.right_width), s.left_census[x]).store(cost + b);
  }
  for (int d = 0; d < n; ++d) {
    if (j0 + d < 0 || j0 + d >= job.right_width) cost[d] = job.outside;
  }
}

// Blends the mutual information of the grey values in (CostMode).
static void mix(const Job& job, const u8* left_row, const u8* right_row, int x, int first, int n, u8* cost) {
  const u8* table = job.mutual + 256 * static_cast<int>(left_row[x]);
  const int j0 = job.right_width - 1 - x + first;
  const int from = clamped(-j0, 0, n), to = clamped(job.right_width - j0, 0, n);
  if (job.mode == CostMode::mutual) {
    for (int d = from; d < to; ++d) cost[d] = table[right_row[j0 + d]];
  } else {
    for (int d = from; d < to; ++d) cost[d] = static_cast<u8>((cost[d] + table[right_row[j0 + d]] + 1) >> 1);
  }
}

constexpr int kSpins = 64;  // then the processor is given to whoever has work

static inline void wait_for_row_before(const Sweep& w, int row, int s) {
  if (s) w.done[row].store(s, std::memory_order_release);
  if (row == 0 || w.threads == 1) return;
  const int ahead = s + 34, wanted = ahead < w.job->width ? ahead : w.job->width;
  for (int spins = 0; w.done[row - 1].load(std::memory_order_acquire) < wanted; ++spins) {
    if (spins < kSpins) relax();
    else w.yield();
  }
}

// Keeps the winner of pixel x: total[0..n) are its total costs, key = smallest << 16 | place.
static inline void keep(const Sweep& w, Scratch& s, int x, int first, int n, u32 key) {
  const Job& job = *w.job;
  const u16* total = s.total;
  const int place = static_cast<int>(key & 0xffff);
  const u16 least = static_cast<u16>(key >> 16);
  const bool inner = place > 0 && place < n - 1;
  s.around[0][x] = inner ? total[place - 1] : least;
  s.around[1][x] = least;
  s.around[2][x] = inner ? total[place + 1] : least;
  s.best[x] = static_cast<i16>(first + place);
  const int at = x - first - place;
  if (at >= 0 && at < job.right_width) {
    const u32 mine = static_cast<u32>(least) << 16 | static_cast<u32>(first + place - w.lowest);
    if (mine < s.right_best[at]) s.right_best[at] = mine;
  }
}

// Whether no disparity but the best and its neighbours costs less than 100 / (100 - uniqueness) of the best.
static inline bool unique(const Job& job, const u16* total, int n, u32 key) {
  const int place = static_cast<int>(key & 0xffff);
  const u32 wanted = ((key >> 16) * 100 + (100 - job.uniqueness) - 1) / (100 - job.uniqueness);
  const u16 limit = static_cast<u16>(wanted);
  int rivals = 0;
  for (int b = 0; b < n; b += kBlock) {
    u32 m = mask_below(Sum16::load(total + b), limit);
    if (n - b < kBlock) m &= (1u << (n - b)) - 1;
    const int near = place - b;
    if (near >= -1 && near <= kBlock) m &= ~static_cast<u32>((7ull << (near + 1)) >> 2);
    rivals |= static_cast<int>(m);
  }
  return rivals == 0;
}

// Left-right check and sub-pixel part of a finished row.
static void finish_row(const Sweep& w, int y, Scratch& s) {
  const Job& job = *w.job;
  float* out = job.disparity + static_cast<std::size_t>(y) * job.width;
  const float nan = __builtin_nanf("");
  for (int x = 0; x < job.width; ++x) {
    const float before = s.around[0][x], at = s.around[1][x], next = s.around[2][x];
    const float higher = before > next ? before : next;
    const float bend = job.parabola ? before + next - 2 * at : higher - at;
    const float part = bend > 0 ? (before - next) / (2 * bend) : 0.0f;
    out[x] = s.best[x] == kNone ? nan : static_cast<float>(s.best[x]) + part;
  }
  if (job.score) {
    for (int x = 0; x < job.width; ++x) job.score[static_cast<std::size_t>(y) * job.width + x] = s.around[1][x];
  }
  if (job.left_right < 0) return;
  for (int x = 0; x < job.width; ++x) {
    const int at = x - s.best[x];
    if (s.best[x] == kNone || at < 0 || at >= job.right_width) {
      out[x] = nan;
      continue;
    }
    const int other = static_cast<int>(s.right_best[at] & 0xffff) + w.lowest;
    const int gap = other > s.best[x] ? other - s.best[x] : s.best[x] - other;
    if (gap > job.left_right) out[x] = nan;
  }
}

static inline void begin_row(const Sweep& w, int y, int step, bool top, Scratch& s) {
  const Job& job = *w.job;
  penalties(job, y, step, top, s);
  if (step > 0) {
    census_row(job.left + y * job.left_stride, job.left_stride, job, job.width, 1, s, s.left_census);
    census_row(job.right + y * job.right_stride, job.right_stride, job, job.right_width, -1, s, s.right_census);
  } else {
    for (int x = 0; x < job.right_width; ++x) s.right_best[x] = 0xffffffffu;
  }
}
