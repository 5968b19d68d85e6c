// Between the levels of the pyramid: halved images, and from the disparities of one level the ranges of the next.
#pragma once
#include "match.h"

namespace sgm {

struct RangeRules {
  int low = 0, count = 0;  // all disparities of the finer level
  int reach = 2;           // pixels of the coarser level around a pixel whose disparities count
  int margin = 1;          // disparities added on both sides
  int hole_limit = 64;     // disparities at most where the coarser level has none
};

// Mean of 2 x 2 pixels; an odd last row or column stands for itself. out is (ceil(height / 2), ceil(width / 2)).
void halve(const Image& image, u8* out);

// coarse (ceil(height / 2), ceil(width / 2)) disparities, NaN = none. Writes first and blocks (height, width); returns the
// disparities of all pixels together.
u64 find_ranges(const float* coarse, int width, int height, const RangeRules& rules, i16* first, u8* blocks);

// Adds to counts (256, 256) each pair of a left grey value and the right one that the disparity (x_left - x_right, NaN =
// none) leads to. Images of the same height; the disparity has the left one's size.
void count_greys(const Image& left, const Image& right, const float* disparity, u32* counts);

}  // namespace sgm
