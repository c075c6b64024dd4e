#include "export/html.h"

#include <fmt/format.h>

#include <cstdint>

namespace iris::exporters::html {
namespace {

constexpr std::string_view kStyle = R"(
:root { color-scheme: light dark; }
body { font: 16px/1.5 system-ui, sans-serif; max-width: 1100px; margin: 2rem auto; padding: 0 1rem; }
h1 { margin-bottom: .5rem; }
table { border-collapse: collapse; margin: .5rem 0; font-variant-numeric: tabular-nums; }
th, td { text-align: left; vertical-align: top; padding: .15rem .9rem .15rem 0; }
tr + tr > * { border-top: 1px solid #8884; }
.facts th { font-weight: 600; white-space: nowrap; }
.big { display: flex; flex-wrap: wrap; gap: .75rem; margin: 1rem 0; }
.big div { background: #8882; border-radius: .4rem; padding: .5rem 1rem; }
.big b { display: block; font-size: 1.35rem; }
.numbers td, .numbers th { text-align: right; }
.numbers td:first-child, .numbers th:first-child { text-align: left; }
.good { border-left: .3rem solid #009e73; padding: .3rem .8rem; background: #009e7318; }
.warning { border-left: .3rem solid #d55e00; padding: .3rem .8rem; background: #d55e0018; }
.rejected { opacity: .6; }
.bad td { background: #d55e0018; }
.columns { display: flex; flex-wrap: wrap; gap: 1.5rem; align-items: flex-start; }
.columns img { width: auto; max-width: 100%; }
.pictures { display: grid; grid-template-columns: repeat(auto-fit, minmax(min(100%, 30rem), 1fr)); gap: 1rem; }
figure { margin: 0; }
figure img, video { width: 100%; background: #fff; border: 1px solid #8886; }
figcaption { font-size: .9rem; opacity: .8; }
summary { cursor: pointer; font-weight: 600; margin: .4rem 0; }
)";

}  // namespace

std::string escape(std::string_view text) {
  std::string escaped;
  for (const char c : text) {
    switch (c) {
      case '&':
        escaped += "&amp;";
        break;
      case '<':
        escaped += "&lt;";
        break;
      case '>':
        escaped += "&gt;";
        break;
      case '"':
        escaped += "&quot;";
        break;
      default:
        escaped += c;
    }
  }
  return escaped;
}

std::string base64(std::span<const unsigned char> bytes) {
  constexpr char kDigits[] = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
  std::string text;
  text.reserve((bytes.size() + 2) / 3 * 4);
  for (size_t i = 0; i < bytes.size(); i += 3) {
    uint32_t group = 0;
    for (size_t k = 0; k < 3; ++k) group = group << 8 | (i + k < bytes.size() ? bytes[i + k] : 0u);
    for (size_t k = 0; k < 4; ++k) text += i + k <= bytes.size() ? kDigits[group >> (18 - 6 * k) & 63] : '=';
  }
  return text;
}

std::string document(std::string_view title, std::string_view head, std::string_view body) {
  return fmt::format(
      "<!DOCTYPE html>\n<html lang=en>\n<head>\n<meta charset=utf-8>\n"
      "<meta name=viewport content=\"width=device-width, initial-scale=1\">\n"
      "<title>{}</title>\n{}\n</head>\n<body>\n{}</body>\n</html>\n",
      escape(title), head, body);
}

std::string page(std::string_view title, std::string_view body) {
  return document(title, fmt::format("<style>{}</style>", kStyle), fmt::format("<h1>{}</h1>\n{}", escape(title), body));
}

std::string figure(std::string_view source, std::string_view caption) {
  return fmt::format(
      "<figure><a href=\"{0}\"><img src=\"{0}\" alt=\"{1}\" loading=lazy></a><figcaption>{1}</figcaption></figure>\n",
      escape(source), escape(caption));
}

std::string details(std::string_view title, std::string_view body) {
  return fmt::format("<details><summary>{}</summary>\n{}</details>\n", escape(title), body);
}

}  // namespace iris::exporters::html
