// Matching costs: census, and mutual information. Rows are those of one strip after another, which know nothing of each
// other: `strips` (strips + 1) says where each begins.

// One bit for each pixel of the window around the centre: 1 where it is not brighter. A warp takes 32 columns of 8
// rows, and what lies around them, into shared memory.
#define ROWS 8

extern "C" __global__ void census(const u8* image, int width, int height, const int* strips, int radius_x, int radius_y,
                                  u64* out) {
  extern __shared__ __align__(16) u32 shared[];
  const int lane = threadIdx.x % 32, columns = (width + 31) / 32, tile = 32 + 2 * radius_x;
  const int x0 = (int)(THREAD / 32 % columns) * 32, y0 = (int)(THREAD / 32 / columns) * ROWS;
  u8* own = (u8*)shared + threadIdx.x / 32 * tile * (ROWS + 2 * radius_y);
  if (y0 >= height) return;
  int strip = 0;
  for (int row = 0; row < ROWS && y0 + row < height; ++row) {
    const int y = y0 + row, x = x0 + lane;
    while (strips[strip + 1] <= y) ++strip;
    const int top = strips[strip], last = strips[strip + 1] - 1;
    if (row == 0 || y == top) {  // a strip knows nothing of the one above
      __syncwarp(ALL);
      for (int v = row; v < ROWS + 2 * radius_y; ++v) {
        const u8* line = image + (u64)clamped(y0 + v - radius_y, top, last) * width;
        for (int u = lane; u < tile; u += 32) own[v * tile + u] = line[clamped(x0 + u - radius_x, 0, width - 1)];
      }
      __syncwarp(ALL);
    }
    const u8* window = own + row * tile + lane;
    const u8 centre = window[radius_y * tile + radius_x];
    u64 bits = 0;
    for (int dy = 0; dy <= 2 * radius_y; ++dy) {
      u32 some = 0;
      const int centre_at = dy == radius_y ? radius_x : -1;  // has no bit: a window has up to 65 pixels
      for (int dx = 0; dx <= 2 * radius_x; ++dx) {
        if (dx != centre_at) some = some << 1 | (u32)(window[dy * tile + dx] <= centre);
      }
      bits = bits << (2 * radius_x + (centre_at < 0)) | some;
    }
    if (x < width) out[(u64)y * width + x] = bits;
  }
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
