// Reads the first array of a NumPy .npz file (a ZIP archive of .npy files) if it holds 32-bit floats in two dimensions.
#pragma once

#include <array>
#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <fstream>
#include <iterator>
#include <opencv2/core.hpp>
#include <stdexcept>
#include <string>
#include <vector>

namespace iris::testing {

// Decompressor for raw "deflate" data (RFC 1951).
class Inflate {
 public:
  Inflate(const uint8_t* data, size_t size) : data_(data), size_(size) {}

  std::vector<uint8_t> run() {
    bool last = false;
    while (!last) {
      last = bits(1) != 0;
      const int type = bits(2);
      if (type == 0) {
        stored();
      } else if (type == 1) {
        fixed();
      } else if (type == 2) {
        dynamic();
      } else {
        throw std::runtime_error("bad deflate block");
      }
    }
    return std::move(out_);
  }

 private:
  // Canonical Huffman code: number of codes of each length, symbols in the order of their codes.
  struct Code {
    std::array<int, 16> count{};
    std::vector<int> symbols;

    explicit Code(const std::vector<int>& lengths) {
      for (const int length : lengths) ++count[length];
      count[0] = 0;
      for (int length = 1; length < 16; ++length) {
        for (size_t s = 0; s < lengths.size(); ++s) {
          if (lengths[s] == length) symbols.push_back(static_cast<int>(s));
        }
      }
    }
  };

  int bits(int n) {
    int value = 0;
    for (int i = 0; i < n; ++i, ++position_) {
      if (position_ / 8 >= size_) throw std::runtime_error("deflate data ends early");
      value |= ((data_[position_ / 8] >> (position_ % 8)) & 1) << i;
    }
    return value;
  }

  int symbol(const Code& code) {
    int value = 0, first = 0, index = 0;
    for (int length = 1; length < 16; ++length) {
      value |= bits(1);
      const int count = code.count[length];
      if (value - first < count) return code.symbols[index + value - first];
      index += count;
      first = (first + count) << 1;
      value <<= 1;
    }
    throw std::runtime_error("bad deflate code");
  }

  void stored() {
    position_ = (position_ + 7) / 8 * 8;
    const int length = bits(16);
    bits(16);
    for (int i = 0; i < length; ++i) out_.push_back(static_cast<uint8_t>(bits(8)));
  }

  void fixed() {
    std::vector<int> lengths(288, 8);
    for (int i = 144; i < 256; ++i) lengths[i] = 9;
    for (int i = 256; i < 280; ++i) lengths[i] = 7;
    block(Code(lengths), Code(std::vector<int>(30, 5)));
  }

  void dynamic() {
    static constexpr int kOrder[19] = {16, 17, 18, 0, 8, 7, 9, 6, 10, 5, 11, 4, 12, 3, 13, 2, 14, 1, 15};
    const int literals = bits(5) + 257, distances = bits(5) + 1, codes = bits(4) + 4;
    std::vector<int> lengths(19, 0);
    for (int i = 0; i < codes; ++i) lengths[kOrder[i]] = bits(3);
    const Code code(lengths);
    std::vector<int> all;
    while (static_cast<int>(all.size()) < literals + distances) {
      const int s = symbol(code);
      if (s < 16) {
        all.push_back(s);
      } else if (s == 16) {
        const int previous = all.back();
        all.insert(all.end(), 3 + bits(2), previous);
      } else {
        all.insert(all.end(), s == 17 ? 3 + bits(3) : 11 + bits(7), 0);
      }
    }
    block(Code({all.begin(), all.begin() + literals}), Code({all.begin() + literals, all.end()}));
  }

  void block(const Code& literals, const Code& distances) {
    static constexpr int kBase[29] = {3,  4,  5,  6,  7,  8,  9,  10, 11,  13,  15,  17,  19,  23, 27,
                                      31, 35, 43, 51, 59, 67, 83, 99, 115, 131, 163, 195, 227, 258};
    static constexpr int kBits[29] = {0, 0, 0, 0, 0, 0, 0, 0, 1, 1, 1, 1, 2, 2, 2,
                                      2, 3, 3, 3, 3, 4, 4, 4, 4, 5, 5, 5, 5, 0};
    static constexpr int kDistanceBase[30] = {1,    2,    3,    4,    5,    7,    9,    13,    17,    25,
                                              33,   49,   65,   97,   129,  193,  257,  385,   513,   769,
                                              1025, 1537, 2049, 3073, 4097, 6145, 8193, 12289, 16385, 24577};
    for (;;) {
      const int s = symbol(literals);
      if (s == 256) return;
      if (s < 256) {
        out_.push_back(static_cast<uint8_t>(s));
        continue;
      }
      const int length = kBase[s - 257] + bits(kBits[s - 257]);
      const int d = symbol(distances);
      const size_t distance = kDistanceBase[d] + bits(d < 2 ? 0 : d / 2 - 1);
      if (distance > out_.size()) throw std::runtime_error("bad deflate distance");
      for (int i = 0; i < length; ++i) out_.push_back(out_[out_.size() - distance]);
    }
  }

  const uint8_t* data_;
  size_t size_;
  size_t position_ = 0;  // in bits
  std::vector<uint8_t> out_;
};

inline cv::Mat1f read_npz_float(const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  const std::vector<char> text((std::istreambuf_iterator<char>(file)), {});
  const auto* bytes = reinterpret_cast<const uint8_t*>(text.data());
  const auto u16 = [&](size_t at) { return bytes[at] | bytes[at + 1] << 8; };
  if (text.size() < 30 || u16(0) != 0x4b50) throw std::runtime_error(path + ": no ZIP archive");
  const int method = u16(8);
  const size_t start = 30 + u16(26) + u16(28);
  const std::vector<uint8_t> npy = method == 8 ? Inflate(bytes + start, text.size() - start).run()
                                               : std::vector<uint8_t>(bytes + start, bytes + text.size());
  const size_t header = npy[8] | npy[9] << 8;
  const std::string description(npy.begin() + 10, npy.begin() + 10 + header);
  const size_t shape = description.find("'shape': (");
  if (description.find("'<f4'") == std::string::npos || shape == std::string::npos) {
    throw std::runtime_error(path + ": not an array of 32-bit floats");
  }
  char* end = nullptr;
  const int rows = static_cast<int>(std::strtol(description.c_str() + shape + 10, &end, 10));
  const int cols = static_cast<int>(std::strtol(end + 1, nullptr, 10));
  cv::Mat1f array(rows, cols);
  std::memcpy(array.data, npy.data() + 10 + header, array.total() * sizeof(float));
  return array;
}

}  // namespace iris::testing
