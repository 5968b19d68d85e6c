// What is launched, for each number of lanes that work on a pixel or a path together.

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

FOR_GROUP(1)
FOR_GROUP(2)
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
