// What both forms do row by row: census, penalties, the winner and its sub-pixel part. Included once for each
// instruction set, inside its own namespace; no inline function of the standard library may enter here, or the linker
// could hand the version for one machine to all.

static inline int clamped(int x, int low, int high) { return x < low ? low : x > high ? high : x; }

// Eight times the cost and twice the half sum of the first sweep.
template <class T>
static inline typename T::Sum forward_sum(T cost, T half) {
  return add(eightfold(cost), pair_sum(half, half));
}

template <class T>
static inline void least_of_four(const T* low, u8* least) {
  for (int k = 0; k < 4; ++k) least[k] = hmin(low[k]);
}

// Sets a bit, not set before, where a is not brighter than the centre.
template <class T>
static inline T with_bit(T plane, T a, T centre, int bit) {
  return add(plane, band(below_or_equal(a, centre), T::set1(static_cast<u8>(1 << bit))));
}

// One bit for each pixel of the window around the centre: 1 where it is not brighter. `side` -1 reads the window
// mirrored, so that bits of a mirrored image have the same meaning. Each byte of the bits has a plane of its own.
static void census_row(const u8* row, std::ptrdiff_t stride, const Job& job, int width, int side, u8* planes,
                       std::ptrdiff_t plane_stride) {
  std::ptrdiff_t offset[64];
  int n = 0;
  for (int dy = -job.radius_y; dy <= job.radius_y; ++dy) {
    for (int dx = -job.radius_x; dx <= job.radius_x; ++dx) {
      if (dx || dy) offset[n++] = dy * stride + side * dx;
    }
  }
  const int whole = n / 8, rest = n % 8;
  for (int x = 0; x < width; x += V::N) {
    const u8* at = row + x;
    const V centre = V::load(at);
    u8* to = planes + x;
    for (int k = 0; k < whole; ++k, to += plane_stride) {
      V plane = V::set1(0);
#pragma GCC unroll 8
      for (int bit = 0; bit < 8; ++bit) plane = with_bit(plane, V::load(at + offset[8 * k + bit]), centre, bit);
      plane.store(to);
    }
    V plane = V::set1(0);
    for (int bit = 0; bit < rest; ++bit) plane = with_bit(plane, V::load(at + offset[8 * whole + bit]), centre, bit);
    if (rest) plane.store(to);
  }
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

template <class T>
static inline void store_first(T a, u8* p, int) { a.store(p); }

#ifndef __AVX512BW__
struct Greys {
  const u8* costs;
  static Greys load(const u8* p) { return {p}; }
};

// Cost of right grey values, or its mean with the census cost.
template <class T>
static inline T told_by_greys(T cost, const Greys& table, const u8* right, bool mean) {
  u8 said[T::N];
  for (int d = 0; d < T::N; ++d) said[d] = table.costs[right[d]];
  return mean ? avg(cost, T::load(said)) : T::load(said);
}
#endif

// The row of the table of mutual information for a left grey value; without such a table anything.
static inline Greys greys_of(const Job& job, const u8* left) {
  return Greys::load(job.mode == CostMode::census ? job.left : job.mutual + 256 * static_cast<int>(*left));
}

template <class T>
static inline T with_greys(const Job& job, T cost, const Greys& table, const u8* right) {
  return job.mode == CostMode::census ? cost : told_by_greys(cost, table, right, job.mode == CostMode::blend);
}

// Costs of n disparities of pixel x from disparity `first` on, for any range, in whole vectors of T: lanes outside the
// right image cost `outside`. The census differs in bits, added byte by byte of it.
template <class T>
static inline void costs(const Job& job, const Scratch& s, int y, int x, int first, int n, u8* cost, T) {
  const u8 *left_row = job.left + y * job.left_stride, *right_row = job.right + y * job.right_stride;
  const int j0 = job.right_width - 1 - x + first;  // mirrored column of the first disparity
  const int from = clamped(-j0, 0, n), to = clamped(job.right_width - j0, from, n);
  T left[8];
  for (int k = 0; k < 8; ++k) left[k] = T::set1(s.left_planes[k * s.plane_stride + x]);
  const Greys greys = greys_of(job, left_row + x);
  for (int b = from / T::N * T::N; b < to; b += T::N) {
    const u8* right = s.right_planes + j0 + b;
    T c = bits(bxor(T::load(right), left[0]));
    for (int k = 1; k < 8; ++k) c = add(c, bits(bxor(T::load(right + k * s.plane_stride), left[k])));
    with_greys(job, c, greys, right_row + j0 + b).store(cost + b);
  }
  if (from > 0) std::memset(cost, job.outside, from);
  if (to < n) std::memset(cost + to, job.outside, n - to);
}

constexpr int kSpins = 64;  // then the processor is given to whoever has work

// Progress of a row (dense: of a band's last row) for the thread that works below it.
static inline void publish(const Sweep& w, int row, int pixels) {
  if (pixels > 0) w.done[row].store(pixels, std::memory_order_release);
}

static inline void wait_for(const Sweep& w, int row, int pixels) {
  if (row < 0 || w.threads == 1) return;
  const int wanted = pixels < w.job->width ? pixels : w.job->width;
  for (int spins = 0; w.done[row].load(std::memory_order_acquire) < wanted; ++spins) {
    if (spins < kSpins) relax();
    else w.yield();
  }
}

// Whether no disparity but the best and its neighbours costs less than 100 / (100 - uniqueness) of the best.
template <class Sum>
static __attribute__((noinline)) bool unique(const Job& job, const u16* total, int n, u32 key) {
  const int place = static_cast<int>(key & 0xffff), least = static_cast<int>(key >> 16);
  for (int d = 0; d < n; ++d) {
    const bool near = d >= place - 1 && d <= place + 1;
    if (!near && total[Sum::at(d)] * (100 - job.uniqueness) < least * 100) return false;
  }
  return true;
}

// Keeps the winner of pixel x: total are its n total costs as a Sum stores them, key = smallest << 16 | place.
template <class Sum>
static inline void keep(const Sweep& w, Scratch& s, int x, int first, int n, u32 key, Sum) {
  const Job& job = *w.job;
  const u16* total = s.total;
  const int place = static_cast<int>(key & 0xffff);
  const u16 least = static_cast<u16>(key >> 16);
  const bool inner = place > 0 && place < n - 1;
  s.around[0][x] = inner ? total[Sum::at(place - 1)] : least;
  s.around[1][x] = least;
  s.around[2][x] = inner ? total[Sum::at(place + 1)] : least;
  s.best[x] = static_cast<i16>(first + place);
  const int at = x - first - place;
  if (at >= 0 && at < job.right_width) {
    const u32 mine = static_cast<u32>(least) << 16 | static_cast<u32>(first + place - w.lowest);
    if (mine < s.right_best[at]) s.right_best[at] = mine;
  }
  if (job.uniqueness > 0 && !unique<Sum>(job, total, n, key)) s.best[x] = kNone;
}

// Left-right check and sub-pixel part of a finished row.
static void finish_row(const Sweep& w, int y, Scratch& s) {
  const Job& job = *w.job;
  float* __restrict out = job.disparity + static_cast<std::size_t>(y) * job.width;
  const i16* __restrict winner = s.best;
  const u16 *__restrict left = s.around[0], *__restrict centre = s.around[1], *__restrict right = s.around[2];
  const float nan = __builtin_nanf("");
  const int steep = job.parabola ? 0 : 1;
  for (int x = 0; x < job.width; ++x) {
    const int before = left[x], at = centre[x], next = right[x], higher = before > next ? before : next;
    const int bend = steep ? higher - at : before + next - 2 * at;  // 0 only where all three are equal
    const float part = static_cast<float>(before - next) / static_cast<float>(2 * (bend > 0 ? bend : 1));
    out[x] = winner[x] == kNone ? nan : static_cast<float>(winner[x]) + part;
  }
  if (job.score) {
    for (int x = 0; x < job.width; ++x) job.score[static_cast<std::size_t>(y) * job.width + x] = s.around[1][x];
  }
  if (job.left_right < 0) return;
  const u32* __restrict right_best = s.right_best;
  for (int x = 0; x < job.width; ++x) {
    const int at = x - winner[x];
    const bool inside = winner[x] != kNone && at >= 0 && at < job.right_width;
    const int gap = static_cast<int>(right_best[inside ? at : 0] & 0xffff) + w.lowest - winner[x];
    const bool agree = gap <= job.left_right && -gap <= job.left_right;
    out[x] = inside && agree ? out[x] : nan;
  }
}

template <int DIR>
static void begin_row(const Sweep& w, int y, bool top, Scratch& s) {
  const Job& job = *w.job;
  penalties(job, y, DIR, top, s);
  if (DIR > 0 || !job.ragged) {
    const u8 *left = job.left + y * job.left_stride, *right = job.right + y * job.right_stride;
    census_row(left, job.left_stride, job, job.width, 1, s.left_planes, s.plane_stride);
    census_row(right, job.right_stride, job, job.right_width, -1, s.right_planes, s.plane_stride);
    for (int x = 0; job.ragged && x < job.width; x += 16) {
      interleave(s.left_planes + x, s.plane_stride, s.left_census + x);
    }
    for (int x = 0; job.ragged && x < job.right_width; x += 16) {
      interleave(s.right_planes + x, s.plane_stride, s.right_census + x);
    }
  }
  for (int x = 0; DIR < 0 && x < job.right_width; ++x) s.right_best[x] = 0xffffffffu;
}
