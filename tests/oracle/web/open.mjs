// node open.mjs PAGE.html WIDTH HEIGHT: time to the first frame of a page, by the clock from the start of navigation and
// of the processor in all of the browser's processes, as JSON.
import {readFileSync, readdirSync} from 'node:fs';
import puppeteer from 'puppeteer-core';

const [file, width, height] = process.argv.slice(2), timeout = 600000;
const browser = await puppeteer.launch({
    executablePath: process.env.CHROMIUM ?? '/usr/bin/chromium', headless: true, protocolTimeout: timeout, timeout,
    args: ['--no-sandbox', '--use-angle=swiftshader', '--enable-unsafe-swiftshader', '--disable-dev-shm-usage'],
    defaultViewport: {width: Number(width), height: Number(height)},
});

/// Seconds that the browser and its children have computed.
function computed() {
    const parent = {}, seconds = {};
    for (const pid of readdirSync('/proc').filter(name => /^\d+$/.test(name))) {
        try {
            const stat = readFileSync(`/proc/${pid}/stat`, 'utf8'), words = stat.slice(stat.lastIndexOf(')') + 2).split(' ');
            parent[pid] = words[1];
            seconds[pid] = (Number(words[11]) + Number(words[12])) / 100;
        } catch { /* it has just ended */ }
    }
    const ours = pid => pid === String(browser.process().pid) || pid in parent && ours(parent[pid]);
    return Object.keys(seconds).filter(ours).reduce((sum, pid) => sum + seconds[pid], 0);
}

const told = {};
try {
    const page = await browser.newPage();
    page.setDefaultTimeout(timeout);
    const before = computed();
    await page.goto('file://' + file, {waitUntil: 'domcontentloaded'});
    await page.waitForFunction(() => document.documentElement.dataset.firstFrame || document.documentElement.dataset.failed, {polling: 50});
    told.cpu_s = Number((computed() - before).toFixed(2));
    told.error = await page.$eval('#error', e => e.hidden ? '' : e.innerText);
    told.first_ms = Number(await page.evaluate(() => document.documentElement.dataset.firstFrame));
    told.marks = await page.evaluate(() => Object.fromEntries(performance.getEntriesByType('mark').map(m => [m.name, Math.round(m.startTime)])));
} finally {
    await browser.close();
}
console.log(JSON.stringify(told));
