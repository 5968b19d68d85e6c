// The matcher of native/sgm on a GPU: the same whole numbers, so the same bits. Compiled at run time (dense/cuda.py).
//
// Each of the eight paths is walked by a group of G lanes, four neighbouring disparities a lane; what a path adds to
// the matching cost (0 .. P2, one byte) goes to memory, and one more kernel sums up and finds the winners. Path costs of
// the pixel before stay in shared memory, with 255 beyond both ends. The right image is not mirrored here.
// Units: disparity d = x_left - x_right in pixels; costs are whole numbers. No libraries are included.

typedef unsigned char u8;
typedef unsigned short u16;
typedef short i16;
typedef unsigned int u32;
typedef unsigned long long u64;

#define ALL 0xffffffffu     // lanes of a warp
#define BYTES 0x00ff00ffu   // two bytes in two halves of a word
#define GUARD 8             // bytes of 255 before and after the path costs of a pixel
#define EMPTY 32000         // least of nothing; the most of nothing is its negative
#define NONE (-32768)       // a pixel without a disparity
#define HOLE_LEVEL 2        // a hole asks cells of 4 x 4 coarse pixels and their neighbours first

__device__ inline int clamped(int x, int low, int high) { return x < low ? low : x > high ? high : x; }
__device__ inline u32 even(u32 v) { return v & BYTES; }
__device__ inline u32 odd(u32 v) { return v >> 8 & BYTES; }

// The disparities of each pixel: of one range (first null), or of its own, some blocks of 16.
struct Ranges {
  const i16* first;
  const u8* blocks;
  const u32* place;     // (height, width): where a pixel begins in its row of the volumes
  const u64* row;       // (height): where a row begins in the volumes
  int low, count, padded, width;
};

struct Span {
  int first, n;         // n: as stored, a multiple of 16
  u64 cell;             // where it begins in the volumes
};

__device__ inline Span span_of(const Ranges& r, int x, int y) {
  const u64 pixel = (u64)y * r.width + x;
  if (!r.first) return {r.low, r.padded, pixel * r.padded};
  return {r.first[pixel], 16 * r.blocks[pixel], r.row[y] + r.place[pixel]};
}

#define RANGES const i16 *first, const u8 *blocks, const u32 *place, const u64 *row, int low, int count, int padded, int width
#define RANGES_HERE const Ranges ranges = {first, blocks, place, row, low, count, padded, width}
#define THREAD ((u64)blockIdx.x * blockDim.x + threadIdx.x)

// --- between the levels ----------------------------------------------------------------------------------------------

extern "C" __global__ void halve(const u8* image, int width, int height, u8* out) {
  const int w = (width + 1) / 2, h = (height + 1) / 2;
  if (THREAD >= (u64)w * h) return;
  const int x = (int)(THREAD % w), y = (int)(THREAD / w);
  const u8* a = image + (u64)(2 * y) * width + 2 * x;
  const u8* b = 2 * y + 1 < height ? a + width : a;
  out[THREAD] = 2 * x + 1 < width ? (u8)((a[0] + a[1] + b[0] + b[1] + 2) >> 2) : (u8)((a[0] + b[0] + 1) >> 1);
}

extern "C" __global__ void joint_greys(const u8* left, const u8* right, const float* disparity, int width, int height,
                                       int right_width, u32* counts) {
  if (THREAD >= (u64)width * height) return;
  const float d = disparity[THREAD];
  if (!(d < EMPTY && d > -EMPTY)) return;  // NaN too
  const int x = (int)(THREAD % width), y = (int)(THREAD / width), there = x - __float2int_rn(d);
  if (there >= 0 && there < right_width) atomicAdd(counts + 256 * left[THREAD] + right[(u64)y * right_width + there], 1u);
}

// Whole disparities of the finer level below and above each coarse one.
extern "C" __global__ void base_grid(const float* coarse, u64 cells, i16* least, i16* most, float* total, float* number) {
  if (THREAD >= cells) return;
  const float c = coarse[THREAD];
  const bool known = c < EMPTY / 2 && c > -EMPTY / 2;
  const float fine = known ? 2 * c : 0.0f;
  const int whole = (int)fine;
  const int low = whole - ((float)whole > fine), high = whole + ((float)whole < fine);
  least[THREAD] = (i16)(known ? low : EMPTY);
  most[THREAD] = (i16)(known ? high : -EMPTY);
  total[THREAD] = known ? 0.5f * (float)(low + high) : 0.0f;
  number[THREAD] = known ? 1.0f : 0.0f;
}

// The grid of half the size behind the grid at `from`; sums in the order of the native module.
extern "C" __global__ void half_grid(i16* least, i16* most, float* total, float* number, u64 from, int width, int height) {
  const int w = (width + 1) / 2, h = (height + 1) / 2;
  if (THREAD >= (u64)w * h) return;
  const int x = (int)(THREAD % w), y = (int)(THREAD / w);
  const u64 to = from + (u64)width * height + THREAD;
  int low = EMPTY, high = -EMPTY;
  float sum = 0, many = 0;
  for (int v = 2 * y; v < 2 * y + 2 && v < height; ++v) {
    const u64 a = from + (u64)v * width + 2 * x;
    const bool two = 2 * x + 1 < width;
    low = min(low, (int)min(least[a], least[two ? a + 1 : a]));
    high = max(high, (int)max(most[a], most[two ? a + 1 : a]));
    sum += total[a] + (two ? total[a + 1] : 0.0f);
    many += number[a] + (two ? number[a + 1] : 0.0f);
  }
  least[to] = (i16)low;
  most[to] = (i16)high;
  total[to] = sum;
  number[to] = many;
}

// Least and most within `reach` cells, along rows (down = 0) or columns.
extern "C" __global__ void spread(const i16* least, const i16* most, int width, int height, int reach, int down,
                                  i16* lows, i16* highs) {
  if (THREAD >= (u64)width * height) return;
  const int x = (int)(THREAD % width), y = (int)(THREAD / width);
  const int at = down ? y : x, end = down ? height : width;
  const u64 step = down ? width : 1, begin = THREAD - (u64)at * step;
  int low = EMPTY, high = -EMPTY;
  for (int k = max(0, at - reach); k <= min(end - 1, at + reach); ++k) {
    low = min(low, (int)least[begin + k * step]);
    high = max(high, (int)most[begin + k * step]);
  }
  lows[THREAD] = (i16)low;
  highs[THREAD] = (i16)high;
}

struct Grids {
  const i16 *least, *most;
  const float *total, *number;
};

// What the smallest neighbourhood that knows anything says of a hole, held to `limit` disparities about its mean.
__device__ inline void ask_around(const Grids& g, int w, int h, int x, int y, int limit, int& least, int& most) {
  u64 begin = 0;
  for (int level = 0;; ++level) {
    if (level >= HOLE_LEVEL) {
      const int cx = x >> level, cy = y >> level;
      int low = EMPTY, high = -EMPTY;
      float total = 0, number = 0;
      for (int v = max(0, cy - 1); v <= min(h - 1, cy + 1); ++v) {
        for (int u = max(0, cx - 1); u <= min(w - 1, cx + 1); ++u) {
          const u64 i = begin + (u64)v * w + u;
          low = min(low, (int)g.least[i]);
          high = max(high, (int)g.most[i]);
          total += g.total[i];
          number += g.number[i];
        }
      }
      if (low <= high) {
        if (high - low >= limit) {
          const int from = (int)(total / number) - limit / 2;
          low = min(max(low, from), high - limit + 1);
          high = low + limit - 1;
        }
        least = low;
        most = high;
        return;
      }
      if (w == 1 && h == 1) return;
    }
    begin += (u64)w * h;
    w = (w + 1) / 2;
    h = (h + 1) / 2;
  }
}

// First disparity and blocks of the four pixels below each coarse one.
extern "C" __global__ void find_ranges(const i16* lows, const i16* highs, const i16* least, const i16* most,
                                       const float* total, const float* number, int width, int height, int low,
                                       int count, int margin, int limit, i16* first, u8* blocks) {
  const int w = (width + 1) / 2, h = (height + 1) / 2, last = low + count - 1;
  if (THREAD >= (u64)w * h) return;
  const int u = (int)(THREAD % w), v = (int)(THREAD / w);
  int from = lows[THREAD], to = highs[THREAD];
  if (least[THREAD] > most[THREAD]) {
    from = EMPTY;
    to = -EMPTY;
    ask_around({least, most, total, number}, w, h, u, v, limit, from, to);
  }
  if (from > to) {
    from = low + margin;
    to = last - margin;
  }
  from = (i16)from;
  to = (i16)to;
  const int begin = min(max(from - margin, low), last), end = max(min(to + margin, last), begin), n = end - begin + 1;
  const int many = (n + 15) / 16, start = begin - (many * 16 - n) / 2;
  for (int y = 2 * v; y < min(2 * v + 2, height); ++y) {
    for (int x = 2 * u; x < min(2 * u + 2, width); ++x) {
      first[(u64)y * width + x] = (i16)start;
      blocks[(u64)y * width + x] = (u8)many;
    }
  }
}

// Where each pixel begins in its row of the volumes; a warp a row. rows (2, height): cells of a row, blocks of its
// pixel that has most.
extern "C" __global__ void lay_out(const u8* blocks, int width, int height, u32* place, u32* rows) {
  const int y = (int)(THREAD / 32), lane = threadIdx.x % 32;
  if (y >= height) return;
  u32 before = 0, most = 0;
  for (int x = lane; x - lane < width; x += 32) {
    const u32 own = x < width ? 16u * blocks[(u64)y * width + x] : 0u;
    u32 sum = own;
    most = max(most, own / 16);
    for (int step = 1; step < 32; step *= 2) {
      const u32 other = __shfl_up_sync(ALL, sum, step, 32);
      if (lane >= step) sum += other;
    }
    if (x < width) place[(u64)y * width + x] = before + sum - own;
    before += __shfl_sync(ALL, sum, 31, 32);
  }
  for (int other = 16; other; other /= 2) most = max(most, __shfl_xor_sync(ALL, most, other, 32));
  if (lane) return;
  rows[y] = before;
  rows[height + y] = most;
}

// --- matching --------------------------------------------------------------------------------------------------------

// One bit for each pixel of the window around the centre: 1 where it is not brighter.
extern "C" __global__ void census(const u8* image, int width, int height, int radius_x, int radius_y, u64* out) {
  if (THREAD >= (u64)width * height) return;
  const int x = (int)(THREAD % width), y = (int)(THREAD / width);
  const u8 centre = image[THREAD];
  u64 bits = 0;
  for (int dy = -radius_y; dy <= radius_y; ++dy) {
    const u8* line = image + (u64)clamped(y + dy, 0, height - 1) * width;
    for (int dx = -radius_x; dx <= radius_x; ++dx) {
      if (dx || dy) bits = bits << 1 | (u64)(line[clamped(x + dx, 0, width - 1)] <= centre);
    }
  }
  out[THREAD] = bits;
}

// Matching costs; mode 0 census, 1 its mean with mutual information, 2 that alone. 255 beyond one range's `count`.
template <int G>
__device__ void costs(const u64* left_bits, const u64* right_bits, const u8* left, const u8* right, const u8* mutual,
                      const Ranges& r, int height, int right_width, int mode, int outside, u8* cost) {
  const u64 pixel = THREAD / G;
  if (pixel >= (u64)r.width * height) return;
  const int x = (int)(pixel % r.width), y = (int)(pixel / r.width);
  const Span span = span_of(r, x, y);
  const u64 bits = left_bits[pixel], there = (u64)y * right_width;
  const u8* table = mode ? mutual + 256 * left[pixel] : left;
  const int limit = r.first ? span.n : r.count;
  for (int b = 4 * (int)(threadIdx.x % G); b < span.n; b += 4 * G) {
    u32 word = 0;
    for (int k = 0; k < 4; ++k) {
      const int at = x - span.first - b - k;
      int c = outside;
      if (at >= 0 && at < right_width) {
        c = __popcll(bits ^ right_bits[there + at]);
        if (mode) {
          const int said = table[right[there + at]];
          c = mode == 1 ? (c + said + 1) >> 1 : said;
        }
      }
      if (b + k >= limit) c = 255;
      word |= (u32)c << (8 * k);
    }
    *(u32*)(cost + span.cell + b) = word;
  }
}

template <int G>
__device__ inline u32 least_of_group(u32 key) {
  for (int other = G / 2; other; other /= 2) key = min(key, __shfl_xor_sync(ALL, key, other, 32));
  return key;
}

// A pixel on the way of a path.
struct Stop {
  Span span;
  u8 grey;
  bool begins;          // the path begins here: there is no pixel before
};

struct Way {
  int x, y, step_x, step_y, i, length;
};

// The pixel at which the way stands; moves it on. Diagonal paths that leave the image begin anew on the other side.
__device__ inline Stop fetch(Way& way, const Ranges& r, const u8* image, bool& wrapped) {
  if (way.i >= way.length) return {{0, 0, 0}, 0, true};
  const Stop stop = {span_of(r, way.x, way.y), image[(u64)way.y * r.width + way.x], way.i == 0 || wrapped};
  way.x += way.step_x;
  way.y += way.step_y;
  ++way.i;
  wrapped = way.step_y && (way.x < 0 || way.x >= r.width);
  if (wrapped) way.x += way.x < 0 ? r.width : -r.width;
  return stop;
}

// What the path adds to the costs of four disparities that stand at `at` in the range of the pixel before (n
// disparities, whose path costs with their guards are `before`): min(L(d), L(d - 1) + P1, L(d + 1) + P1, min L + P2) -
// min L, and P2 outside that range.
__device__ inline u32 added(const u32* before, int at, int n, u32 base, u32 penalty, u32 small) {
  const int i = clamped(at, -4, n), a = i - 1 + GUARD, shift = (a & 3) * 8;
  const u32 *p = before + (a >> 2), p0 = p[0], p1 = p[1], p2 = p[2];
  const u32 less = __funnelshift_r(p0, p1, shift), more = __funnelshift_r(p1, p2, shift);
  const u32 same = __byte_perm(less, more, 0x4321), next = __byte_perm(less, more, 0x5432);
  const u32 low = base * 0x10001u, jump = low + penalty * 0x10001u;
  const u32 e = __vminu2(__vminu2(__vminu2(even(less), even(next)) + small, even(same)), jump) - low;
  const u32 o = __vminu2(__vminu2(__vminu2(odd(less), odd(next)) + small, odd(same)), jump) - low;
  u32 part = e | o << 8;
  if (i < 0 || i > n - 4) {
    u32 inside = i == -4 ? 0u : i < 0 ? ALL << (-8 * i) : ALL;
    const int left = n - i;
    if (left < 4) inside &= left <= 0 ? 0u : ALL >> (32 - 8 * left);
    part = (part & inside) | (penalty * 0x01010101u & ~inside);
  }
  return part;
}

__device__ inline u32 cost_at(const u8* cost, const Stop& stop, int b) {
  return b < stop.span.n ? *(const u32*)(cost + stop.span.cell + b) : ALL;
}

// Directions 0 to 3 are the native module's first sweep, 4 to 7 the second. `table`: adaptive P2 by grey step.
template <int G>
__device__ void paths(const u8* cost, const u8* image, const u8* table, const Ranges& r, int height, int small,
                      int pitch, u64 cells, u8* parts) {
  extern __shared__ u32 shared[];
  const int direction = blockIdx.y, forward = direction < 4 ? 1 : -1, kind = direction % 4;
  Way way = {0, 0, forward * (kind == 3 ? -1 : kind != 2), forward * (kind != 0), 0, kind ? height : r.width};
  const int chains = kind ? r.width : height, lane = threadIdx.x % 32, own = lane % G;
  const int first_chain = (int)(THREAD / 32) * (32 / G);
  if (first_chain >= chains) return;
  const int chain = min(first_chain + lane / G, chains - 1);  // groups too many do the last one again
  way.x = kind ? chain : forward > 0 ? 0 : r.width - 1;
  way.y = kind ? (forward > 0 ? 0 : height - 1) : chain;
  u32 *line = shared + threadIdx.x / G * 2 * (pitch / 4), *before = line + pitch / 4;
  for (int i = own; i < pitch / 4; i += G) line[i] = before[i] = ALL;
  u8* out = parts + direction * cells;
  const u32 step = (u32)small * 0x10001u;
  bool wrapped = false;
  Stop here = fetch(way, r, image, wrapped), next = fetch(way, r, image, wrapped);
  u32 ahead = cost_at(cost, here, 4 * own), base = 0;
  int first_before = 0, n_before = 0, grey_before = 0;
  __syncwarp(ALL);
  for (int i = 0; i < way.length; ++i) {
    const u32 now = ahead;
    ahead = cost_at(cost, next, 4 * own);
    const Stop later = fetch(way, r, image, wrapped);
    const u32 penalty = here.begins ? 0 : table[min(abs(here.grey - grey_before) >> 2, 15)];
    const int n = here.span.n, offset = here.span.first - first_before;
    u32 low = BYTES;
    for (int b = 4 * own; b < n; b += 4 * G) {
      const u32 c = b == 4 * own ? now : *(const u32*)(cost + here.span.cell + b);
      const u32 part = added(before, offset + b, n_before, base, penalty, step);
      *(u32*)(out + here.span.cell + b) = part;
      const u32 e = __vminu2(even(c) + even(part), BYTES), o = __vminu2(odd(c) + odd(part), BYTES);
      line[(GUARD + b) / 4] = e | o << 8;
      low = __vminu2(low, __vminu2(e, o));
    }
    if (own < GUARD / 4) line[(GUARD + n) / 4 + own] = ALL;
    base = min(low & 0xffffu, low >> 16);
    base = least_of_group<G>(base);
    first_before = here.span.first;
    n_before = n;
    grey_before = here.grey;
    here = next;
    next = later;
    u32* other = line;
    line = before;
    before = other;
    __syncwarp(ALL);
  }
}

struct Total {
  u32 even, odd;  // of disparities 0 and 2, 1 and 3
};

// Eight times the cost, what the eight paths add, and one where what the first sweep's four add is odd: the native
// module keeps half their sum, rounded up.
__device__ inline Total total_at(const u8* cost, const u8* parts, u64 cells, u64 cell) {
  const u32 c = *(const u32*)(cost + cell);
  u32 e = 0, o = 0;
  for (int k = 0; k < 8; ++k) {
    const u32 part = *(const u32*)(parts + k * cells + cell);
    e += even(part);
    o += odd(part);
    if (k == 3) {
      e += e & 0x10001u;
      o += o & 0x10001u;
    }
  }
  return {e + 8 * even(c), o + 8 * odd(c)};
}

__device__ inline u32 total_of(const u8* cost, const u8* parts, u64 cells, u64 cell) {
  const Total t = total_at(cost, parts, cells, cell & ~3ull);
  const u32 two = cell & 1 ? t.odd : t.even;
  return cell & 2 ? two >> 16 : two & 0xffffu;
}

// The winner of each pixel, total costs before, at and after it, and for each right pixel the cheapest left one.
template <int G>
__device__ void winners(const u8* cost, const u8* parts, const Ranges& r, int height, u64 cells, int right_width,
                        int uniqueness, i16* best, u16* around, u32* right_best) {
  const u64 pixels = (u64)r.width * height, mine = THREAD / G, pixel = mine < pixels ? mine : pixels - 1;
  const int x = (int)(pixel % r.width), y = (int)(pixel / r.width), own = threadIdx.x % G;
  const Span span = span_of(r, x, y);
  const int limit = r.first ? span.n : r.count;
  u32 key = ALL;
  for (int b = 4 * own; b < limit; b += 4 * G) {
    const Total t = total_at(cost, parts, cells, span.cell + b);
    key = min(key, (t.even & 0xffffu) << 16 | b);
    if (b + 1 < limit) key = min(key, (t.odd & 0xffffu) << 16 | (b + 1));
    if (b + 2 < limit) key = min(key, (t.even & 0xffff0000u) | (b + 2));
    if (b + 3 < limit) key = min(key, (t.odd & 0xffff0000u) | (b + 3));
  }
  key = least_of_group<G>(key);
  const int at = (int)(key & 0xffffu);
  const u32 least = key >> 16;
  bool unique = true;
  for (int b = own; uniqueness > 0 && b < limit; b += G) {
    const bool near = b >= at - 1 && b <= at + 1;
    if (!near && total_of(cost, parts, cells, span.cell + b) * (100 - uniqueness) < least * 100) unique = false;
  }
  unique = least_of_group<G>(unique) != 0;
  if (mine >= pixels || own) return;
  const bool inner = at > 0 && at < limit - 1;
  around[pixel] = (u16)(inner ? total_of(cost, parts, cells, span.cell + at - 1) : least);
  around[pixels + pixel] = (u16)least;
  around[2 * pixels + pixel] = (u16)(inner ? total_of(cost, parts, cells, span.cell + at + 1) : least);
  const int disparity = span.first + at, there = x - disparity;
  best[pixel] = (i16)(unique ? disparity : NONE);
  if (there >= 0 && there < right_width) {
    atomicMin(right_best + (u64)y * right_width + there, least << 16 | (u32)(disparity - NONE));
  }
}

// Left-right check and sub-pixel part.
extern "C" __global__ void finish(const i16* best, const u16* around, const u32* right_best, int width, int height,
                                  int right_width, int left_right, int parabola, float* disparity) {
  const u64 pixels = (u64)width * height;
  if (THREAD >= pixels) return;
  const int x = (int)(THREAD % width), y = (int)(THREAD / width), winner = best[THREAD], there = x - winner;
  const int before = around[THREAD], at = around[pixels + THREAD], next = around[2 * pixels + THREAD];
  const int bend = parabola ? before + next - 2 * at : max(before, next) - at;  // 0 only where all three are equal
  const float part = (float)(before - next) / (float)(2 * (bend > 0 ? bend : 1));
  bool stands = winner != NONE;
  if (stands && left_right >= 0) {
    stands = there >= 0 && there < right_width;
    if (stands) {
      const int gap = (int)(right_best[(u64)y * right_width + there] & 0xffffu) + NONE - winner;
      stands = gap <= left_right && -gap <= left_right;
    }
  }
  disparity[THREAD] = stands ? (float)winner + part : __int_as_float(0x7fc00000);
}

#define FOR_GROUP(G)                                                                                                  \
  extern "C" __global__ void costs_##G(const u64* left_bits, const u64* right_bits, const u8* left, const u8* right, \
                                       const u8* mutual, RANGES, int height, int right_width, int mode, int outside, \
                                       u8* cost) {                                                                    \
    RANGES_HERE;                                                                                                      \
    costs<G>(left_bits, right_bits, left, right, mutual, ranges, height, right_width, mode, outside, cost);           \
  }                                                                                                                   \
  extern "C" __global__ void paths_##G(const u8* cost, const u8* image, const u8* table, RANGES, int height,          \
                                       int small, int pitch, u64 cells, u8* parts) {                                  \
    RANGES_HERE;                                                                                                      \
    paths<G>(cost, image, table, ranges, height, small, pitch, cells, parts);                                         \
  }                                                                                                                   \
  extern "C" __global__ void winners_##G(const u8* cost, const u8* parts, RANGES, int height, u64 cells,              \
                                         int right_width, int uniqueness, i16* best, u16* around, u32* right_best) {  \
    RANGES_HERE;                                                                                                      \
    winners<G>(cost, parts, ranges, height, cells, right_width, uniqueness, best, around, right_best);                \
  }

FOR_GROUP(4)
FOR_GROUP(8)
FOR_GROUP(16)
FOR_GROUP(32)
