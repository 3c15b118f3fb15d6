// node drive.mjs PAGE.html FOLDER WIDTH HEIGHT: opens a page in a browser without a window, turns it, shows each field,
// clicks, scrubs; leaves screenshots in FOLDER and says what it saw as JSON.
import puppeteer from 'puppeteer-core';

const [file, folder, width, height] = process.argv.slice(2), timeout = 400000;
const browser = await puppeteer.launch({
    executablePath: process.env.CHROMIUM ?? '/usr/bin/chromium', headless: true, protocolTimeout: timeout, timeout,
    args: ['--no-sandbox', '--use-angle=swiftshader', '--enable-unsafe-swiftshader', '--disable-dev-shm-usage', '--force-color-profile=srgb'],
    defaultViewport: {width: Number(width), height: Number(height)},
});
const told = {requests: [], messages: [], shots: {}, clicks: [], frames: []};
try {
    const page = await browser.newPage();
    page.setDefaultTimeout(timeout);
    page.on('request', request => told.requests.push(request.url()));
    page.on('console', message => told.messages.push(`${message.type()}: ${message.text()}`));
    page.on('pageerror', error => told.messages.push(`pageerror: ${error.message}`));
    const state = () => page.evaluate(() => ({...document.documentElement.dataset}));
    const settled = async () => {  // at rest, with everything drawn
        for (let last = '', now = ' '; last !== now;) {
            last = now;
            await new Promise(resolve => setTimeout(resolve, 500));
            const s = await state();
            now = s.failed ? last : s.whole === s.frames ? s.frames : ' ' + s.frames + Math.random();
        }
    };
    const shot = async name => {
        told.shots[name] = `${folder}/${name}.png`;
        await page.screenshot({path: told.shots[name]});
    };
    await page.goto('file://' + file, {waitUntil: 'domcontentloaded'});
    await page.waitForFunction(() => document.documentElement.dataset.ready || document.documentElement.dataset.failed);
    told.error = await page.$eval('#error', e => e.hidden ? '' : e.innerText);
    if (!told.error) {
        await settled();
        await shot('first');
        told.first = Number((await state()).firstFrame);
        const x = width * 0.5, y = height * 0.52;
        // Where the scene is: here and beside.
        for (const [dx, dy] of [[0, 0], [-0.06, 0.05], [0.05, -0.05]]) {
            await page.mouse.click(x + dx * width, y + dy * height);
            await page.waitForFunction(() => !document.getElementById('explain').hidden, {timeout: 60000}).catch(() => {});
            await new Promise(resolve => setTimeout(resolve, 300));
            told.clicks.push(await page.evaluate(() => document.getElementById('explain').hidden ? null : {
                text: document.getElementById('told').innerText, command: document.querySelector('.command')?.textContent ?? '',
                point: document.getElementById('explain').dataset.point ?? '',
                copy: document.querySelector('.copy')?.innerText ?? ''}));
        }
        await shot('explained');
        await page.keyboard.press('Escape');
        await page.mouse.move(x, y);
        await page.mouse.down();
        await page.mouse.move(x + width * 0.15, y - height * 0.05, {steps: 4});
        await page.mouse.up();
        await settled();
        await shot('turned');
        told.fields = await page.$$eval('#fields button', buttons => buttons.map(b => b.dataset.field));
        for (const field of told.fields) {
            await page.evaluate(name => [...document.querySelectorAll('#fields button')].find(b => b.dataset.field === name).click(), field);
            await settled();
            await shot('field_' + (field || 'plain'));
            told.bars = {...told.bars, [field]: await page.evaluate(() => document.getElementById('bar').hidden ? '' : document.getElementById('bar').innerText)};
        }
        await page.keyboard.press('0');
        if (await page.$eval('#time', e => !e.hidden))
            for (const index of [0, Number(await page.$eval('#slider', e => e.max))]) {
                await page.$eval('#slider', (e, i) => { e.value = i; e.dispatchEvent(new Event('input')); }, index);
                await page.waitForFunction(i => document.documentElement.dataset.frame === String(i) || document.documentElement.dataset.failed, {}, index);
                await settled();
                told.frames.push(await page.$eval('#moment', e => e.textContent));
                await shot('frame_' + index);
            }
    }
    told.state = await state();
    // As graphics cards draw it: other materials, shadows.
    const rich = await browser.newPage();
    rich.setDefaultTimeout(timeout);
    rich.on('console', message => told.messages.push(`${message.type()}: ${message.text()}`));
    rich.on('pageerror', error => told.messages.push(`pageerror: ${error.message}`));
    await rich.goto(`file://${file}#rich`, {waitUntil: 'domcontentloaded'});
    await rich.waitForFunction(() => document.documentElement.dataset.whole || document.documentElement.dataset.failed);
    told.shots.rich = `${folder}/rich.png`;
    await rich.screenshot({path: told.shots.rich});
} finally {
    await browser.close();
}
console.log(JSON.stringify(told));
