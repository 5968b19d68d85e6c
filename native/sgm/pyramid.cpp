#include "pyramid.h"

#include <algorithm>
#include <cmath>
#include <stdexcept>

namespace sgm {

namespace {

constexpr int kEmpty = 32000;     // least of nothing; the most of nothing is its negative
constexpr int kMaxBlocks = 255;
constexpr int kFirstHoleLevel = 2;  // cells of 4 x 4 coarse pixels and their neighbours: 16 to 24 finer pixels

// Least and most disparity of each cell of a grid, and the mean of what is in it.
struct Grid {
  int width, height;
  std::vector<i16> least, most;
  std::vector<float> total, number;

  Grid(int w, int h)
      : width(w), height(h), least(cells(), kEmpty), most(cells(), -kEmpty), total(cells()), number(cells()) {}
  std::size_t cells() const { return static_cast<std::size_t>(width) * height; }
  std::size_t at(int x, int y) const { return static_cast<std::size_t>(y) * width + x; }
};

struct Range {
  int least = kEmpty, most = -kEmpty;
};

Grid base_grid(const float* coarse, int width, int height) {
  Grid grid(width, height);
  i16 *__restrict least = grid.least.data(), *__restrict most = grid.most.data();
  float *__restrict total = grid.total.data(), *__restrict number = grid.number.data();
  for (std::size_t i = 0; i < grid.cells(); ++i) {
    const bool known = std::fabs(coarse[i]) < kEmpty / 2;  // not NaN either
    const float fine = known ? 2 * coarse[i] : 0.0f;
    const int whole = static_cast<int>(fine);
    const int low = whole - (static_cast<float>(whole) > fine), high = whole + (static_cast<float>(whole) < fine);
    least[i] = static_cast<i16>(known ? low : kEmpty);
    most[i] = static_cast<i16>(known ? high : -kEmpty);
    total[i] = known ? 0.5f * static_cast<float>(low + high) : 0.0f;
    number[i] = known ? 1.0f : 0.0f;
  }
  return grid;
}

// Least and most within `reach` cells along one row of n values, `step` apart.
template <class Better>
void spread_line(const i16* __restrict in, i16* __restrict out, int n, int reach, Better better) {
  std::copy(in, in + n, out);
  for (int k = 1; k <= reach; ++k) {
    for (int x = k; x < n; ++x) out[x] = better(out[x], in[x - k]);
    for (int x = 0; x < n - k; ++x) out[x] = better(out[x], in[x + k]);
  }
}

template <class Better>
std::vector<i16> spread(const std::vector<i16>& in, int width, int height, int reach, Better better) {
  std::vector<i16> rows(in.size()), out;
  for (int y = 0; y < height; ++y) {
    const std::size_t row = static_cast<std::size_t>(y) * width;
    spread_line(&in[row], &rows[row], width, reach, better);
  }
  out = rows;
  for (int y = 0; y < height; ++y) {
    i16* __restrict to = &out[static_cast<std::size_t>(y) * width];
    for (int k = std::max(0, y - reach); k <= std::min(height - 1, y + reach); ++k) {
      const i16* __restrict from = &rows[static_cast<std::size_t>(k) * width];
      for (int x = 0; x < width; ++x) to[x] = better(to[x], from[x]);
    }
  }
  return out;
}

Grid halved(const Grid& fine) {
  Grid g((fine.width + 1) / 2, (fine.height + 1) / 2);
  for (int y = 0; y < fine.height; ++y) {
    const std::size_t from = fine.at(0, y), to = g.at(0, y / 2);
    const i16 *least = &fine.least[from], *most = &fine.most[from];
    const float *total = &fine.total[from], *number = &fine.number[from];
    for (int x = 0; x < g.width; ++x) {
      const int a = 2 * x, b = std::min(2 * x + 1, fine.width - 1);
      g.least[to + x] = std::min(g.least[to + x], std::min(least[a], least[b]));
      g.most[to + x] = std::max(g.most[to + x], std::max(most[a], most[b]));
      g.total[to + x] += total[a] + (b > a ? total[b] : 0.0f);
      g.number[to + x] += number[a] + (b > a ? number[b] : 0.0f);
    }
  }
  return g;
}

// What the smallest neighbourhood that knows anything says of a hole, held to `limit` disparities about its mean.
Range of_hole(const std::vector<Grid>& grids, int x, int y, int limit) {
  for (std::size_t level = kFirstHoleLevel; level < grids.size(); ++level) {
    const Grid& g = grids[level];
    const int cx = x >> level, cy = y >> level;
    Range r;
    float total = 0, number = 0;
    for (int v = std::max(0, cy - 1); v <= std::min(g.height - 1, cy + 1); ++v) {
      for (int u = std::max(0, cx - 1); u <= std::min(g.width - 1, cx + 1); ++u) {
        const std::size_t i = g.at(u, v);
        r.least = std::min<int>(r.least, g.least[i]);
        r.most = std::max<int>(r.most, g.most[i]);
        total += g.total[i];
        number += g.number[i];
      }
    }
    if (r.least > r.most) continue;
    if (r.most - r.least >= limit) {
      const int low = static_cast<int>(total / number) - limit / 2;
      r.least = std::min(std::max(r.least, low), r.most - limit + 1);
      r.most = r.least + limit - 1;
    }
    return r;
  }
  return {};
}

}  // namespace

void halve(const Image& image, u8* out) {
  const int width = (image.width + 1) / 2, height = (image.height + 1) / 2;
  for (int y = 0; y < height; ++y) {
    const u8* a = image.data + static_cast<std::size_t>(2 * y) * image.width;
    const u8* b = 2 * y + 1 < image.height ? a + image.width : a;
    u8* o = out + static_cast<std::size_t>(y) * width;
    for (int x = 0; x < image.width / 2; ++x) {
      o[x] = static_cast<u8>((a[2 * x] + a[2 * x + 1] + b[2 * x] + b[2 * x + 1] + 2) >> 2);
    }
    if (image.width % 2) o[width - 1] = static_cast<u8>((a[image.width - 1] + b[image.width - 1] + 1) >> 1);
  }
}

u64 find_ranges(const float* coarse, int width, int height, const RangeRules& rules, i16* first, u8* blocks) {
  if (width < 1 || height < 1) throw std::invalid_argument("an image has at least one pixel");
  if (rules.count < 1 || rules.count > kBlock * kMaxBlocks) throw std::invalid_argument("1 to 4080 disparities");
  if (rules.low < -20000 || rules.low + rules.count > 20000) throw std::invalid_argument("disparities beyond +-20000");
  if (rules.reach < 0 || rules.margin < 0 || rules.hole_limit < 1) throw std::invalid_argument("ranges below zero");
  const int w = (width + 1) / 2, h = (height + 1) / 2;
  std::vector<Grid> grids{base_grid(coarse, w, h)};
  while (grids.back().width > 1 || grids.back().height > 1 || grids.size() <= kFirstHoleLevel) {
    grids.push_back(halved(grids.back()));
  }
  const Grid& base = grids[0];
  const auto lower = [](i16 a, i16 b) { return b < a ? b : a; };
  const auto higher = [](i16 a, i16 b) { return b > a ? b : a; };
  const std::vector<i16> least = spread(base.least, w, h, rules.reach, lower);
  const std::vector<i16> most = spread(base.most, w, h, rules.reach, higher);
  const int last = rules.low + rules.count - 1;
  std::vector<i16> lows(w), highs(w), starts(w);
  std::vector<u8> many(w);
  u64 cells = 0;
  for (int v = 0; v < h; ++v) {
    for (int u = 0; u < w; ++u) {
      const std::size_t i = base.at(u, v);
      Range r{least[i], most[i]};
      if (base.least[i] > base.most[i]) r = of_hole(grids, u, v, rules.hole_limit);
      if (r.least > r.most) r = {rules.low + rules.margin, last - rules.margin};
      lows[u] = static_cast<i16>(r.least);
      highs[u] = static_cast<i16>(r.most);
    }
    for (int u = 0; u < w; ++u) {
      const int low = std::min(std::max(lows[u] - rules.margin, rules.low), last);
      const int high = std::max(std::min(highs[u] + rules.margin, last), low);
      const int n = high - low + 1;
      many[u] = static_cast<u8>((n + kBlock - 1) / kBlock);
      starts[u] = static_cast<i16>(low - (many[u] * kBlock - n) / 2);
    }
    for (int y = 2 * v; y < std::min(2 * v + 2, height); ++y) {
      i16* f = first + static_cast<std::size_t>(y) * width;
      u8* b = blocks + static_cast<std::size_t>(y) * width;
      for (int x = 0; x < width; ++x) {
        f[x] = starts[x / 2];
        b[x] = many[x / 2];
      }
      for (int x = 0; x < width; ++x) cells += b[x];
    }
  }
  return kBlock * cells;
}

void count_greys(const Image& left, const Image& right, const float* disparity, u32* counts) {
  for (int y = 0; y < left.height; ++y) {
    const u8* a = left.data + static_cast<std::size_t>(y) * left.width;
    const u8* b = right.data + static_cast<std::size_t>(y) * right.width;
    const float* d = disparity + static_cast<std::size_t>(y) * left.width;
    for (int x = 0; x < left.width; ++x) {
      if (!(std::fabs(d[x]) < kEmpty)) continue;  // NaN too
      const long there = x - std::lrint(d[x]);
      if (there >= 0 && there < right.width) ++counts[256 * a[x] + b[there]];
    }
  }
}

}  // namespace sgm
