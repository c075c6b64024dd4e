// Which views look alike, whatever their poses: binary descriptors become words of a vocabulary that is trained on the
// session itself, views become weighted sets of words (Sivic and Zisserman 2003, Nister and Stewenius 2006; binary
// words as Galvez-Lopez and Tardos 2012).
#pragma once

#include <array>
#include <cstdint>
#include <opencv2/core.hpp>
#include <vector>

namespace iris::loop {

constexpr int kDescriptorBytes = 32;  // ORB: 256 bits

// At most `count` ORB descriptors of an image, one row of kDescriptorBytes bytes each.
cv::Mat1b describe(const cv::Mat1b& image, int count);

// A tree of words: children of a node are the majorities, bit by bit, of the descriptors nearest to them (k-means in
// Hamming distance).
class Vocabulary {
 public:
  static constexpr int kBranches = 10;    // children of a node
  static constexpr int kDepth = 4;        // most levels, 10^4 words
  static constexpr int kLeast = 20;       // descriptors of a node that is divided further
  static constexpr int kSample = 200000;  // descriptors that take part, evenly taken from all

  Vocabulary() = default;  // one word
  // The descriptors of all views, in any number of rows each. Equal input, equal vocabulary: no random numbers.
  explicit Vocabulary(const std::vector<cv::Mat1b>& descriptors);

  int words() const { return words_; }
  int word(const uint8_t* descriptor) const;

 private:
  using Bits = std::array<uint64_t, kDescriptorBytes / 8>;
  struct Node {
    Bits centre{};
    int first_child = -1, children = 0;
    int word = -1;  // of leaves
  };
  std::vector<Node> nodes_{Node{.word = 0}};
  int words_ = 1;
};

struct ScoredView {
  int index = 0;     // of the view, in the order of add()
  double score = 0;  // cosine of the angle between the weighted sets of words, 0 to 1
};

// Inverted index over views. Memory: 8 bytes a feature (about 24 MB for 10 000 views of 300 features).
class ViewIndex {
 public:
  ViewIndex() = default;

  // Trains the vocabulary and forgets all views.
  void train(const std::vector<cv::Mat1b>& descriptors);

  // Adds a view; the first added has index 0.
  void add(const cv::Mat1b& descriptors);

  // Weighs words by how few of the views have them (tf-idf). After the last add, before the first query.
  void finish();

  int size() const { return static_cast<int>(views_.size()); }
  const Vocabulary& vocabulary() const { return vocabulary_; }

  // The `count` views most like view `index`, itself not among them; best first, the lower index among equals. Only
  // views of positive score. May be called from several threads.
  std::vector<ScoredView> query(int index, int count) const;

  // Likeness of two views.
  double score(int a, int b) const;

 private:
  struct Weighted {
    int key = 0;  // word, or view
    float weight = 0;
  };
  Vocabulary vocabulary_;
  std::vector<std::vector<Weighted>> views_;     // words of each view, ascending; weights of length 1 after finish()
  std::vector<std::vector<Weighted>> postings_;  // views of each word, ascending
};

}  // namespace iris::loop
