// Smallest value and its first place over a long row of totals, one vector of 16 lanes after the other.
struct Running16 {
  u32 key = 0xffffffffu;
  void see(Sum16 t, int at) {
    const u32 k = argmin(t) + static_cast<u32>(at);
    key = k < key ? k : key;
  }
  u32 result() const { return key; }
};
