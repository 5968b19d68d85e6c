// The matcher of native/sgm on a GPU: the same whole numbers, so the same bits. Compiled at run time (dense/cuda.py).
//
// Each of the eight paths is walked by a group of G lanes, words of four neighbouring disparities a lane; what a path
// adds to the matching cost (0 .. P2, one byte) goes to memory, and one more kernel sums up and finds the winners. The
// right image is not mirrored here.
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

// The disparities of a pixel in the volumes.
struct Span {
  int first, n;         // n: as stored, a multiple of 16
  u64 cell;             // where it begins
};

// A pixel with a range of its own, eight bytes: one load.
struct Pixel {
  u32 block;            // where it begins in the volumes, in blocks of 16
  i16 first;
  u8 blocks, grey;
};

// The disparities of all pixels: one range (pixels null), or each its own.
struct Ranges {
  const Pixel* pixels;
  int low, count, padded, width, height;
};

__device__ inline Span span_of(const Ranges& r, u64 pixel) {
  if (!r.pixels) return {r.low, r.padded, pixel * r.padded};
  const Pixel p = r.pixels[pixel];
  return {p.first, 16 * p.blocks, 16ull * p.block};
}

#define RANGES const Pixel *pixels, int low, int count, int padded, int width, int height
#define RANGES_HERE const Ranges ranges = {pixels, low, count, padded, width, height}
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

// Blocks (height) of each row, and of its pixel that has most (height); a warp a row.
extern "C" __global__ void row_blocks(const u8* blocks, int width, int height, u32* sums, u32* most) {
  const int y = (int)(THREAD / 32), lane = threadIdx.x % 32;
  if (y >= height) return;
  u32 sum = 0, largest = 0;
  for (int x = lane; x < width; x += 32) {
    sum += blocks[(u64)y * width + x];
    largest = max(largest, (u32)blocks[(u64)y * width + x]);
  }
  for (int other = 16; other; other /= 2) {
    sum += __shfl_xor_sync(ALL, sum, other, 32);
    largest = max(largest, __shfl_xor_sync(ALL, largest, other, 32));
  }
  if (lane) return;
  sums[y] = sum;
  most[y] = largest;
}

// The pixels of each row, which begins at `starts` in blocks of 16; a warp a row.
extern "C" __global__ void lay_out(const u8* image, const i16* first, const u8* blocks, const u32* starts, int width,
                                   int height, Pixel* pixels) {
  const int y = (int)(THREAD / 32), lane = threadIdx.x % 32;
  if (y >= height) return;
  u32 before = starts[y];
  for (int x = lane; x - lane < width; x += 32) {
    const u64 at = (u64)y * width + x;
    const u32 own = x < width ? (u32)blocks[at] : 0u;
    u32 sum = own;
    for (int step = 1; step < 32; step *= 2) {
      const u32 other = __shfl_up_sync(ALL, sum, step, 32);
      if (lane >= step) sum += other;
    }
    if (x < width) pixels[at] = {before + sum - own, first[at], (u8)own, image[at]};
    before += __shfl_sync(ALL, sum, 31, 32);
  }
}

// --- matching --------------------------------------------------------------------------------------------------------

// Rows are those of one strip after another, which know nothing of each other: `strips` (strips + 1) says where each
// begins.

// One bit for each pixel of the window around the centre: 1 where it is not brighter.
extern "C" __global__ void census(const u8* image, int width, int height, const int* strips, int radius_x, int radius_y,
                                  u64* out) {
  if (THREAD >= (u64)width * height) return;
  const int x = (int)(THREAD % width), y = (int)(THREAD / width);
  int strip = 0;
  while (strips[strip + 1] <= y) ++strip;
  const int top = strips[strip], last = strips[strip + 1] - 1;
  const u8 centre = image[THREAD];
  u64 bits = 0;
  for (int dy = -radius_y; dy <= radius_y; ++dy) {
    const u8* line = image + (u64)clamped(y + dy, top, last) * width;
    for (int dx = -radius_x; dx <= radius_x; ++dx) {
      if (dx || dy) bits = bits << 1 | (u64)(line[clamped(x + dx, 0, width - 1)] <= centre);
    }
  }
  out[THREAD] = bits;
}

// Matching costs; mode 0 census, 1 its mean with mutual information, 2 that alone. 255 beyond one range's `count`.
template <int G>
__device__ void costs(const u64* left_bits, const u64* right_bits, const u8* left, const u8* right, const u8* mutual,
                      const Ranges& r, int right_width, int mode, int outside, u8* cost) {
  const u64 pixel = THREAD / G;
  if (pixel >= (u64)r.width * r.height) return;
  const int x = (int)(pixel % r.width), y = (int)(pixel / r.width);
  const Span span = span_of(r, pixel);
  const u64 bits = left_bits[pixel], there = (u64)y * right_width;
  const u8* table = mode ? mutual + 256 * left[pixel] : left;
  const int limit = r.pixels ? span.n : r.count;
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

// A path through one strip. Diagonal paths that leave the image begin anew on the other side.
struct Way {
  int x, y, step_x, step_y, i, length, width;
  bool begins;          // there is no pixel before

  __device__ bool ended() const { return i >= length; }
  __device__ u64 pixel() const { return (u64)y * width + x; }
  __device__ void go_on() {
    x += step_x;
    y += step_y;
    ++i;
    begins = x < 0 || x >= width;
    if (begins && step_y) x += x < 0 ? width : -width;
  }
};

// Directions 0 to 3 are the native module's first sweep, 4 to 7 the second. A warp's paths, 32 / G, lie in one strip and
// are equally long; those too many do the last one again.
template <int G>
__device__ inline Way way_of(const Ranges& r, const int* strips) {
  const int forward = blockIdx.y < 4 ? 1 : -1, kind = blockIdx.y % 4, each = 32 / G, own = threadIdx.x % 32 / G;
  const int warp = (int)(THREAD / 32), warps = (r.width + each - 1) / each;
  const int row = min(warp * each + own, r.height - 1);
  if (!kind) return {forward > 0 ? 0 : r.width - 1, row, forward, 0, 0, r.width, r.width, true};
  const int strip = warp / warps, top = strips[strip], rows = strips[strip + 1] - top;
  const int x = min(warp % warps * each + own, r.width - 1), y = forward > 0 ? top : top + rows - 1;
  return {x, y, forward * (kind == 3 ? -1 : kind == 1), forward, 0, rows, r.width, true};
}

// Whether this warp has paths at all: a launch has the same number of warps for all directions.
template <int G>
__device__ inline bool idle(const Ranges& r, int number) {
  const int each = 32 / G, warp = (int)(THREAD / 32);
  return blockIdx.y % 4 ? warp >= number * ((r.width + each - 1) / each) : warp * each >= r.height;
}

__device__ inline u32 doubled(u32 v) { return v * 0x10001u; }
__device__ inline u32 packed(u32 even, u32 odd) { return even + (odd << 8); }

// What a path adds to the costs of disparities, from the path costs of the pixel before:
// min(L(d), L(d - 1) + P1, L(d + 1) + P1, min L + P2) - min L.
__device__ inline u32 added(u32 less, u32 same, u32 more, u32 small, u32 jump, u32 base) {
  return __vminu2(__vminu2(__vminu2(less, more) + small, same), jump) - base;
}

__device__ inline u32 penalty_of(const u8* table, bool begins, int grey, int before) {
  return begins ? 0u : (u32)table[min(abs(grey - before) >> 2, 15)];
}

// One range for all pixels: path costs stay in registers, W words of four disparities a lane.
template <int W>
struct alignas(W < 4 ? 4 * W : 16) Words {
  u32 v[W];
};

template <int G, int W>
__device__ void dense_paths(const u8* cost, const u8* image, const u8* table, const Ranges& r, const int* strips,
                            int number, int small, u64 cells, u8* parts) {
  const int own = threadIdx.x % G, b = 4 * W * own;
  if (idle<G>(r, number)) return;
  Way way = way_of<G>(r, strips);
  const bool has = b < r.padded;
  const u8* from = cost + b;
  u8* out = parts + blockIdx.y * cells + b;
  const u32 step = doubled(small);
  u32 e[W], o[W], base = 0;
  Words<W> ahead;
  for (int w = 0; w < W; ++w) {
    e[w] = o[w] = 0;
    ahead.v[w] = ALL;
  }
  u64 cell = way.pixel() * r.padded;
  bool begins = true;
  int grey = image[way.pixel()], grey_before = grey;
  if (has) ahead = *(const Words<W>*)(from + cell);
  while (!way.ended()) {
    const Words<W> now = ahead;
    const u64 cell_now = cell;
    const u32 penalty = penalty_of(table, begins, grey, grey_before);
    grey_before = grey;
    way.go_on();
    begins = way.begins;
    if (!way.ended()) {
      cell = way.pixel() * r.padded;
      grey = image[way.pixel()];
      if (has) ahead = *(const Words<W>*)(from + cell);
    }
    const u32 before = __shfl_up_sync(ALL, o[W - 1], 1, G), after = __shfl_down_sync(ALL, e[0], 1, G);
    const u32 low = doubled(base), jump = low + doubled(penalty);
    u32 least = ALL, last = own ? before : 0xff0000u;  // odd disparities of the word before
    Words<W> part;
#pragma unroll
    for (int w = 0; w < W; ++w) {
      const u32 next = w + 1 < W ? e[w + 1 < W ? w + 1 : w] : own + 1 < G ? after : 0xffu;
      const u32 pe = added(__byte_perm(last, o[w], 0x5432), e[w], o[w], step, jump, low);
      const u32 po = added(e[w], o[w], __byte_perm(e[w], next, 0x5432), step, jump, low);
      last = o[w];
      part.v[w] = packed(pe, po);
      e[w] = even(now.v[w]) + pe;
      o[w] = odd(now.v[w]) + po;
      least = __vminu2(least, __vminu2(e[w], o[w]));
    }
    if (has) *(Words<W>*)(out + cell_now) = part;
    base = least_of_group<G>(min(least & 0xffffu, least >> 16));
  }
}

// Ranges of their own: the path costs of the pixel before stand in shared memory, with 255 beyond both ends. What the
// path adds to the costs of four disparities that stand at `at` in the range of the pixel before (n disparities): P2
// outside it.
__device__ inline u32 added_at(const u32* before, int at, int n, u32 base, u32 penalty, u32 small) {
  const int i = clamped(at, -4, n), a = i - 1 + GUARD, shift = (a & 3) * 8;
  const u32 *p = before + (a >> 2), p0 = p[0], p1 = p[1], p2 = p[2];
  const u32 less = __funnelshift_r(p0, p1, shift), more = __funnelshift_r(p1, p2, shift);
  const u32 same = __byte_perm(less, more, 0x4321), next = __byte_perm(less, more, 0x5432);
  const u32 low = doubled(base), jump = low + doubled(penalty);
  const u32 e = added(even(less), even(same), even(next), small, jump, low);
  const u32 o = added(odd(less), odd(same), odd(next), small, jump, low);
  u32 part = packed(e, o);
  if (i < 0 || i > n - 4) {
    u32 inside = i == -4 ? 0u : i < 0 ? ALL << (-8 * i) : ALL;
    const int left = n - i;
    if (left < 4) inside &= left <= 0 ? 0u : ALL >> (32 - 8 * left);
    part = (part & inside) | (penalty * 0x01010101u & ~inside);
  }
  return part;
}

__device__ inline Pixel pixel_at(const Ranges& r, const Way& way) {
  return way.ended() ? Pixel{0, 0, 0, 0} : r.pixels[way.pixel()];
}

#define FETCHED 4  // words a lane holds of the costs of the next pixel: more are read when they are needed

template <int G>
__device__ inline void fetch(const u8* cost, const Pixel& p, int own, u32* words) {
  const u32* from = (const u32*)(cost + 16ull * p.block) + own;
#pragma unroll
  for (int w = 0; w < FETCHED; ++w) words[w] = 4 * (own + w * G) < 16 * p.blocks ? from[w * G] : ALL;
}

template <int G>
__device__ void ragged_paths(const u8* cost, const u8* table, const Ranges& r, const int* strips, int number, int small,
                             int pitch, u64 cells, u8* parts) {
  extern __shared__ u32 shared[];
  if (idle<G>(r, number)) return;
  const int own = threadIdx.x % G;
  Way way = way_of<G>(r, strips);
  u32 *line = shared + threadIdx.x / G * 2 * (pitch / 4), *before = line + pitch / 4;
  for (int i = own; i < pitch / 4; i += G) line[i] = before[i] = ALL;
  u8* out = parts + blockIdx.y * cells;
  const u32 step = doubled(small);
  bool begins = true;
  Pixel here = pixel_at(r, way);
  way.go_on();
  bool begins_next = way.begins;
  Pixel next = pixel_at(r, way), last = {0, 0, 0, 0};
  u32 ahead[FETCHED], base = 0;
  fetch<G>(cost, here, own, ahead);
  __syncwarp(ALL);
  while (here.blocks) {
    u32 now[FETCHED];
#pragma unroll
    for (int w = 0; w < FETCHED; ++w) now[w] = ahead[w];
    fetch<G>(cost, next, own, ahead);
    if (!way.ended()) way.go_on();
    const Pixel later = pixel_at(r, way);
    const u32 penalty = penalty_of(table, begins, here.grey, last.grey);
    const int n = 16 * here.blocks, n_before = 16 * last.blocks, offset = here.first - last.first;
    const u64 cell = 16ull * here.block;
    u32 least = ALL;
#pragma unroll
    for (int w = 0; w < FETCHED; ++w) {
      const int b = 4 * (own + w * G);
      if (b >= n) break;
      const u32 part = added_at(before, offset + b, n_before, base, penalty, step), c = now[w];
      *(u32*)(out + cell + b) = part;
      const u32 e = even(c) + even(part), o = odd(c) + odd(part);
      line[(GUARD + b) / 4] = packed(e, o);
      least = __vminu2(least, __vminu2(e, o));
    }
    for (int b = 4 * (own + FETCHED * G); b < n; b += 4 * G) {
      const u32 part = added_at(before, offset + b, n_before, base, penalty, step);
      const u32 c = *(const u32*)(cost + cell + b);
      *(u32*)(out + cell + b) = part;
      const u32 e = even(c) + even(part), o = odd(c) + odd(part);
      line[(GUARD + b) / 4] = packed(e, o);
      least = __vminu2(least, __vminu2(e, o));
    }
    if (own < GUARD / 4) line[(GUARD + n) / 4 + own] = ALL;
    base = least_of_group<G>(min(least & 0xffffu, least >> 16));
    last = here;
    here = next;
    next = later;
    begins = begins_next;
    begins_next = way.begins;
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
__device__ void winners(const u8* cost, const u8* parts, const Ranges& r, u64 cells, int right_width, int uniqueness,
                        i16* best, u16* around, u32* right_best) {
  const u64 pixels = (u64)r.width * r.height, mine = THREAD / G, pixel = mine < pixels ? mine : pixels - 1;
  const int x = (int)(pixel % r.width), y = (int)(pixel / r.width), own = threadIdx.x % G;
  const Span span = span_of(r, pixel);
  const int limit = r.pixels ? span.n : r.count;
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
                                       const u8* mutual, RANGES, int right_width, int mode, int outside, u8* cost) {  \
    RANGES_HERE;                                                                                                      \
    costs<G>(left_bits, right_bits, left, right, mutual, ranges, right_width, mode, outside, cost);                   \
  }                                                                                                                   \
  extern "C" __global__ void ragged_paths_##G(const u8* cost, const u8* table, RANGES, const int* strips, int number, \
                                              int small, int pitch, u64 cells, u8* parts) {                           \
    RANGES_HERE;                                                                                                      \
    ragged_paths<G>(cost, table, ranges, strips, number, small, pitch, cells, parts);                                 \
  }                                                                                                                   \
  extern "C" __global__ void winners_##G(const u8* cost, const u8* parts, RANGES, u64 cells, int right_width,         \
                                         int uniqueness, i16* best, u16* around, u32* right_best) {                   \
    RANGES_HERE;                                                                                                      \
    winners<G>(cost, parts, ranges, cells, right_width, uniqueness, best, around, right_best);                        \
  }

#define FOR_WORDS(G, W)                                                                                               \
  extern "C" __global__ void dense_paths_##G##_##W(const u8* cost, const u8* image, const u8* table, RANGES,          \
                                                   const int* strips, int number, int small, u64 cells, u8* parts) {  \
    RANGES_HERE;                                                                                                      \
    dense_paths<G, W>(cost, image, table, ranges, strips, number, small, cells, parts);                               \
  }

FOR_GROUP(4)
FOR_GROUP(8)
FOR_GROUP(16)
FOR_GROUP(32)
FOR_WORDS(4, 1)
FOR_WORDS(4, 2)
FOR_WORDS(8, 2)
FOR_WORDS(16, 2)
FOR_WORDS(32, 2)
FOR_WORDS(32, 4)
FOR_WORDS(32, 8)
FOR_WORDS(32, 16)
