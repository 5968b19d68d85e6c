// Between the levels of the pyramid: halved images, and from the disparities of one level the ranges of the next.

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
  if (there < 0 || there >= right_width) return;
  atomicAdd(counts + 256 * left[THREAD] + right[(u64)y * right_width + there], 1u);
}

// Whole disparities of the finer level below and above each coarse one.
extern "C" __global__ void base_grid(const float* coarse, u64 cells, i16* least, i16* most, float* total,
                                     float* number) {
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
extern "C" __global__ void half_grid(i16* least, i16* most, float* total, float* number, u64 from, int width,
                                     int height) {
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
