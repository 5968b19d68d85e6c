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

  Grid(int w, int h) : width(w), height(h), least(cells(w, h), kEmpty), most(cells(w, h), -kEmpty) {}
  static std::size_t cells(int w, int h) { return static_cast<std::size_t>(w) * h; }
  std::size_t at(int x, int y) const { return static_cast<std::size_t>(y) * width + x; }
};

struct Range {
  int least = kEmpty, most = -kEmpty;
};

void include(Grid& grid, std::size_t i, float disparity) {
  if (!(std::fabs(disparity) < kEmpty / 2)) return;  // NaN too
  grid.least[i] = std::min(grid.least[i], static_cast<i16>(std::floor(2 * disparity)));
  grid.most[i] = std::max(grid.most[i], static_cast<i16>(std::ceil(2 * disparity)));
}

Grid base_grid(const float* coarse, int width, int height) {
  Grid grid(width, height);
  for (std::size_t i = 0; i < Grid::cells(width, height); ++i) include(grid, i, coarse[i]);
  return grid;
}

// Least and most within `reach` cells along one row of n values, `step` apart.
template <class Better>
void spread_line(const i16* in, i16* out, int n, int reach, Better better) {
  for (int x = 0; x < n; ++x) {
    i16 v = in[x];
    for (int k = std::max(0, x - reach); k <= std::min(n - 1, x + reach); ++k) v = better(v, in[k]);
    out[x] = v;
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
    i16* to = &out[static_cast<std::size_t>(y) * width];
    for (int k = std::max(0, y - reach); k <= std::min(height - 1, y + reach); ++k) {
      const i16* from = &rows[static_cast<std::size_t>(k) * width];
      for (int x = 0; x < width; ++x) to[x] = better(to[x], from[x]);
    }
  }
  return out;
}

Grid halved(const Grid& fine, bool base) {
  Grid g((fine.width + 1) / 2, (fine.height + 1) / 2);
  g.total.assign(Grid::cells(g.width, g.height), 0);
  g.number = g.total;
  for (int y = 0; y < fine.height; ++y) {
    for (int x = 0; x < fine.width; ++x) {
      const std::size_t i = fine.at(x, y), o = g.at(x / 2, y / 2);
      if (fine.least[i] > fine.most[i]) continue;
      g.least[o] = std::min(g.least[o], fine.least[i]);
      g.most[o] = std::max(g.most[o], fine.most[i]);
      g.total[o] += base ? 0.5f * static_cast<float>(fine.least[i] + fine.most[i]) : fine.total[i];
      g.number[o] += base ? 1.0f : fine.number[i];
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
    grids.push_back(halved(grids.back(), grids.size() == 1));
  }
  const Grid& base = grids[0];
  const auto lower = [](i16 a, i16 b) { return b < a ? b : a; };
  const auto higher = [](i16 a, i16 b) { return b > a ? b : a; };
  const std::vector<i16> least = spread(base.least, w, h, rules.reach, lower);
  const std::vector<i16> most = spread(base.most, w, h, rules.reach, higher);
  const int last = rules.low + rules.count - 1;
  u64 cells = 0;
  for (int v = 0; v < h; ++v) {
    for (int u = 0; u < w; ++u) {
      const std::size_t i = base.at(u, v);
      Range r{least[i], most[i]};
      if (base.least[i] > base.most[i]) r = of_hole(grids, u, v, rules.hole_limit);
      if (r.least > r.most) r = {rules.low, last};
      const int low = std::min(std::max(r.least - rules.margin, rules.low), last);
      const int high = std::max(std::min(r.most + rules.margin, last), low);
      const int n = high - low + 1, many = (n + kBlock - 1) / kBlock;
      const i16 start = static_cast<i16>(low - (many * kBlock - n) / 2);
      for (int y = 2 * v; y < std::min(2 * v + 2, height); ++y) {
        for (int x = 2 * u; x < std::min(2 * u + 2, width); ++x) {
          first[static_cast<std::size_t>(y) * width + x] = start;
          blocks[static_cast<std::size_t>(y) * width + x] = static_cast<u8>(many);
          cells += static_cast<u64>(many) * kBlock;
        }
      }
    }
  }
  return cells;
}

}  // namespace sgm
